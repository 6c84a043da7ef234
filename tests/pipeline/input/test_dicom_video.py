"""Films inside DICOM files, wrapped by pydicom as PS3.5 A.4 says, against the same stream read bare."""

import io

import av
import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.input.video import Source
from tests.helpers.videos import textured_frames

pydicom = pytest.importorskip("pydicom", reason="pydicom is not installed")

FRAMES = textured_frames(8, size=96)
SYNTAX = {
    "h264": "1.2.840.10008.1.2.4.102",
    "mp4": "1.2.840.10008.1.2.4.102",
    "hevc": "1.2.840.10008.1.2.4.107",
    "mpeg2video": "1.2.840.10008.1.2.4.100",
    "mpegts": "1.2.840.10008.1.2.4.101",
    "mjpeg": "1.2.840.10008.1.2.4.50",
}
CODEC = {"h264": "libx264", "mp4": "libx264", "hevc": "libx265", "mpegts": "mpeg2video"}  # others: of the kind's name
PATIENT = "Doe^Jane"


def encoded(kind):
    """A bare stream of the frames, and its frames' bytes one by one."""
    buffer, packets = io.BytesIO(), []
    with av.open(buffer, "w", format=kind) as container:
        stream = container.add_stream(CODEC.get(kind, kind), rate=20)
        stream.height, stream.width = FRAMES[0].shape[:2]
        stream.pix_fmt = "yuvj420p" if kind == "mjpeg" else "yuv420p"
        for frame in FRAMES:
            for packet in stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")):
                packets.append(bytes(packet))
                container.mux(packet)
        for packet in stream.encode():
            packets.append(bytes(packet))
            container.mux(packet)
    return buffer.getvalue(), packets


def dicom(path, kind, syntax=None, fragments=1, **fields):
    from pydicom.encaps import encapsulate

    stream, packets = encoded(kind)
    data = pydicom.Dataset()
    data.PatientName, data.PatientID = PATIENT, "4711"
    data.SOPClassUID, data.SOPInstanceUID = "1.2.840.10008.5.1.4.1.1.77.1.1.1", pydicom.uid.generate_uid()
    data.Rows, data.Columns, data.SamplesPerPixel, data.BitsAllocated = 96, 96, 3, 8
    data.BitsStored, data.HighBit, data.PixelRepresentation = 8, 7, 0
    data.PhotometricInterpretation, data.NumberOfFrames = "YBR_PARTIAL_420", len(FRAMES)
    for name, value in fields.items():
        setattr(data, name, value)
    data.PixelData = encapsulate(packets if kind == "mjpeg" else [stream], fragments_per_frame=fragments)
    data["PixelData"].is_undefined_length = True
    data.file_meta = pydicom.dataset.FileMetaDataset()
    data.file_meta.TransferSyntaxUID = syntax or SYNTAX[kind]
    data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID
    data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID
    data.save_as(path, enforce_file_format=True)
    return path, stream


@pytest.mark.parametrize("kind", sorted(SYNTAX))
def test_the_film_is_that_of_the_stream(tmp_path, kind):
    path, stream = dicom(tmp_path / "a.dcm", kind, FrameTime=50.0)
    with av.open(io.BytesIO(stream), format=kind if kind == "mjpeg" else None) as container:
        expected = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    found = list(Source(path))
    assert len(found) == len(expected) == len(FRAMES)
    for mine, theirs in zip(found, expected, strict=True):
        np.testing.assert_array_equal(mine.rgb, theirs)
    np.testing.assert_allclose([frame.seconds for frame in found], 0.05 * np.arange(len(FRAMES)))


def test_a_stream_in_several_fragments(tmp_path):
    whole, _ = dicom(tmp_path / "a.dcm", "hevc")
    cut, _ = dicom(tmp_path / "b.dcm", "hevc", fragments=3)
    for mine, theirs in zip(Source(cut), Source(whole), strict=True):
        np.testing.assert_array_equal(mine.rgb, theirs.rgb)


def test_without_its_name_s_ending_and_by_cine_rate(tmp_path):
    path, _ = dicom(tmp_path / "IM000001", "h264", CineRate=10)
    np.testing.assert_allclose([frame.seconds for frame in Source(path)], 0.1 * np.arange(len(FRAMES)))


def test_the_patient_stays_in_the_file(tmp_path):
    from pipeline.input.dicom_video import read_dicom_video

    path, _ = dicom(tmp_path / "a.dcm", "h264")
    assert PATIENT.encode() in path.read_bytes()
    film, source = read_dicom_video(path), Source(path)
    list(source)
    assert PATIENT.encode() not in film.stream.getvalue()
    assert PATIENT not in repr(vars(source))


@pytest.mark.parametrize("kind", ["h264", "mjpeg"])
def test_a_file_that_is_cut_off(tmp_path, kind):
    path, _ = dicom(tmp_path / "a.dcm", kind)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(HaustraError, match="cut off") as refusal:
        list(Source(path))
    assert "\n" not in str(refusal.value)


def test_single_pictures_are_refused(tmp_path):
    path, _ = dicom(tmp_path / "a.dcm", "mjpeg", syntax="1.2.840.10008.1.2.5")
    with pytest.raises(HaustraError, match=r"single pictures \(RLE Lossless\)"):
        Source(path)


def test_the_times_of_a_vector(tmp_path):
    path, _ = dicom(tmp_path / "a.dcm", "mjpeg", FrameTimeVector=[0.0] + [100.0] * 7)
    np.testing.assert_allclose([frame.seconds for frame in Source(path)], 0.1 * np.arange(len(FRAMES)))


@pytest.mark.parametrize(("old", "new"), [(b"50.0", b"-5.0"), (b"50.0", b"fast"), (b"50.0", b" nan")])
def test_a_rate_that_is_none_is_one_sentence(tmp_path, old, new):
    path, _ = dicom(tmp_path / "a.dcm", "mjpeg", FrameTime=50.0)
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(HaustraError, match=r"FrameTime of .*a.dcm gives no number of frames a second"):
        Source(path)
