"""Turn folders of images into the videos that the benchmarks feed to `reconstruct`."""

from pathlib import Path

import av
import cv2


def encode_video(images: list[Path], target: Path, fps: int = 30, crf: int = 16) -> Path:
    """H.264 yuv420p, as an endoscope's recorder would; odd sizes are padded by repeating the last row or column."""
    with av.open(str(target), "w", options={"movflags": "faststart"}) as container:
        stream = container.add_stream("libx264", rate=fps)
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": str(crf)}
        height, width = cv2.imread(str(images[0]), cv2.IMREAD_COLOR).shape[:2]
        stream.height, stream.width = height + height % 2, width + width % 2
        for path in images:
            image = cv2.imread(str(path), cv2.IMREAD_COLOR)
            image = cv2.copyMakeBorder(image, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode())
    return target
