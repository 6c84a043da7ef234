"""Camera files of one lens, as each format documents them: 640x480, centre (322.5, 238.25) in OpenCV's pixels."""

import json

OPENCV_YAML = """%YAML:1.0
---
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 410., 0., 322.5, 0., 405., 238.25, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.2, 0.05, 0.001, -0.002, 0.01 ]
"""
OPENCV_XML = """<?xml version="1.0"?>
<opencv_storage>
<image_Width>640</image_Width><image_Height>480</image_Height>
<Camera_Matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>410. 0. 322.5 0. 405. 238.25 0. 0. 1.</data></Camera_Matrix>
<Distortion_Coefficients type_id="opencv-matrix"><rows>5</rows><cols>1</cols><dt>d</dt>
<data>-0.2 0.05 0.001 -0.002 0.01</data></Distortion_Coefficients>
</opencv_storage>
"""
SCARED = """%YAML:1.0
---
M1: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 410., 0., 322.5, 0., 405., 238.25, 0., 0., 1. ]
D1: !!opencv-matrix
   rows: 1
   cols: 5
   dt: d
   data: [ -0.2, 0.05, 0.001, -0.002, 0.01 ]
M2: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 1., 0., 1., 0., 1., 1., 0., 0., 1. ]
"""
ROS = """image_width: 640
image_height: 480
camera_name: scope
camera_matrix: {rows: 3, cols: 3, data: [410.0, 0.0, 322.5, 0.0, 405.0, 238.25, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.2, 0.05, 0.001, -0.002, 0.01]}
projection_matrix: {rows: 3, cols: 4, data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]}
"""
ROS_2 = """width: 640
height: 480
distortion_model: plumb_bob
d: [-0.2, 0.05, 0.001, -0.002, 0.01]
k: [410.0, 0.0, 322.5, 0.0, 405.0, 238.25, 0.0, 0.0, 1.0]
"""
ROS_PRINTED = f"{ROS_2}roi: {{x_offset: 0, y_offset: 0, height: 0, width: 0, do_rectify: false}}\n---\n"
ROS_PART = (  # of a sensor of 1280x960 pixels
    ROS_2.replace("640", "1280").replace("480", "960").replace("322.5", "622.5").replace("238.25", "438.25")
    + "roi: {x_offset: 300, y_offset: 200, height: 480, width: 640}\n"
)
PYSLAM = """# a comment
Camera.fx: 410
Camera.fy: 405
Camera.cx: 322.5
Camera.cy: 238.25
Camera.k1: -0.2
Camera.k2: 0.05
Camera.p1: 0.001
Camera.p2: -0.002
Camera.k3: 0.01
Camera.width: 640
Camera.height: 480
"""
MATLAB = {  # (1, 1) is the centre of the first pixel; IntrinsicMatrix is transposed
    "RadialDistortion": [-0.2, 0.05, 0.01],
    "TangentialDistortion": [0.001, -0.002],
    "ImageSize": [480, 640],
    "IntrinsicMatrix": [[410, 0, 0], [0, 405, 0], [323.5, 239.25, 1]],
}
MATLAB_NEW = {"K": [[410, 0, 323.5], [0, 405, 239.25], [0, 0, 1]]} | {
    k: MATLAB[k] for k in ("RadialDistortion", "TangentialDistortion", "ImageSize")
}
NERFSTUDIO = {  # counts from the corner of the first pixel
    "camera_model": "OPENCV",
    "fl_x": 410,
    "fl_y": 405,
    "cx": 323.0,
    "cy": 238.75,
    "w": 640,
    "h": 480,
    "k1": -0.2,
    "k2": 0.05,
    "k3": 0.01,
    "p1": 0.001,
    "p2": -0.002,
    "frames": [],
}
PYTHON_JSON = {
    "camera_matrix": [[410, 0, 322.5], [0, 405, 238.25], [0, 0, 1]],
    "dist_coeff": [[-0.2, 0.05, 0.001, -0.002, 0.01]],
}
BY_COLUMNS = {
    "width": 640,
    "height": 480,
    "intrinsic_matrix": [410, 0, 0, 0, 405, 0, 322.5, 238.25, 1],  # as Open3D has it
    "distortion": PYTHON_JSON["dist_coeff"],
}
PRINTED_NUMPY = r"""camera_matrix: "[[ 410.    0.    322.5 ]\n [   0.  405.  238.25]\n [ 0. 0. 1. ]]"
dist_coeffs: '[[-0.2  0.05  0.001  -0.002  0.01]]'
full: '[0, 0, 640, 480]'
"""
TEXT = "410 0 322.5\n0 405 238.25\n0 0 1\n-0.2 0.05 0.001 -0.002 0.01\n"

BROWN_FILES = {
    "opencv.yaml": OPENCV_YAML,
    "opencv.xml": OPENCV_XML,
    "endoscope_calibration.yaml": SCARED,
    "ros.yaml": ROS,
    "ros2.yaml": ROS_2,
    "printed.yaml": ROS_PRINTED,
    "part.yaml": ROS_PART,
    "pyslam.yaml": PYSLAM,
    "orbslam.yaml": '%YAML:1.0\nCamera.type: "PinHole"\n'
    + PYSLAM.replace("Camera.f", "Camera1.f")
    .replace("Camera.c", "Camera1.c")
    .replace("Camera.k", "Camera1.k")
    .replace("Camera.p", "Camera1.p"),
    "matlab.json": json.dumps(MATLAB),
    "matlab_new.json": json.dumps(MATLAB_NEW),
    "transforms.json": json.dumps(NERFSTUDIO),
    "python.json": json.dumps(PYTHON_JSON),
    "by_columns.json": json.dumps(BY_COLUMNS),
    "printed.yml": PRINTED_NUMPY,
    "calib.intrinsics.txt": TEXT,
    "cameras.txt": "# Camera list\n7 FULL_OPENCV 640 480 410 405 323 238.75 -0.2 0.05 0.001 -0.002 0.01 0 0 0\n",
}
WITHOUT_SIZE = {"python.json", "calib.intrinsics.txt", "endoscope_calibration.yaml"}

KALIBR = """cam0:
  camera_model: pinhole
  distortion_model: equidistant
  intrinsics: [410, 405, 322.5, 238.25]
  distortion_coeffs: [-0.13, -0.006, 0.0016, -0.0001]
  resolution: [640, 480]
cam1:
  camera_model: omni
"""
ENDOMAPPER = """<rig><camera><camera_model name="" index="0" type="calibu_fu_fv_u0_v0_kb4" version="8">
<width> 640 </width><height> 480 </height>
<right> [ 1; 0; 0 ] </right>
<params> [ 410; 405; 322.5; 238.25; -0.13; -0.006; 0.0016; -0.0001 ] </params>
</camera_model></camera></rig>
"""
ORB_FISHEYE = """%YAML:1.0
Camera.type: "KannalaBrandt8"
Camera1.fx: 410.
Camera1.fy: 405.
Camera1.cx: 322.5
Camera1.cy: 238.25
Camera1.k1: -0.13
Camera1.k2: -0.006
Camera1.k3: 0.0016
Camera1.k4: -0.0001
Camera.width: 640
Camera.height: 480
Camera.newWidth: 320
Camera.newHeight: 240
"""
NR_SLAM = (
    ORB_FISHEYE.replace("Camera1", "Camera")
    .replace(".type", ".model")
    .replace(".k1", ".k0")
    .replace(".k2", ".k1")
    .replace(".k3", ".k2")
    .replace(".k4", ".k3")
)
FISHEYE_FILES = {
    "camchain.yaml": KALIBR,
    "Endoscope_00_geometrical.xml": ENDOMAPPER,
    "orbslam3.yaml": ORB_FISHEYE,
    "nrslam.yaml": NR_SLAM,
    "defslam.yaml": ORB_FISHEYE.replace('Camera.type: "KannalaBrandt8"\n', "").replace("Camera1", "Camera"),
    "ros.yaml": ROS.replace("plumb_bob", "equidistant").replace(
        "cols: 5, data: [-0.2, 0.05, 0.001, -0.002, 0.01]", "cols: 4, data: [-0.13, -0.006, 0.0016, -0.0001]"
    ),
    "transforms.json": json.dumps(
        NERFSTUDIO
        | {"camera_model": "OPENCV_FISHEYE", "k1": -0.13, "k2": -0.006, "k3": 0.0016, "k4": -0.0001, "p1": 0, "p2": 0}
    ),
    "flag.json": json.dumps(
        {"fisheye": True, "image_size": [640, 480], "D": [-0.13, -0.006, 0.0016, -0.0001]}
        | {"K": PYTHON_JSON["camera_matrix"]}
    ),
    "reim.json": json.dumps(
        {"model": "FISHEYE_OPENCV", "fx": 410, "fy": 405, "cx": 323.0, "cy": 238.75, "w": 640, "h": 480}
        | {"k1": -0.13, "k2": -0.006, "k3": 0.0016, "k4": -0.0001}
    ),
}
