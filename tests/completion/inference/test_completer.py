"""`DepthCompleter` and its exported twin: batches, number formats, order of the points, ONNX."""

import copy

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from completion import DepthCompleter
from completion.inference import completer as completer_module
from completion.inference.completer import load_depth_network, normalise_exposure
from completion.inference.onnx_export import DESCRIPTION, LAST, RECURRENT_USE, export_onnx
from completion.networks.channel_attention import attention_features
from completion.networks.cpu.fused_conv import FusedConvReLU, can_fuse, fuse_convolutions
from completion.networks.mscsa import DoubleConv
from completion.networks.mscsa_sfm import ScaleInvariantConfig, ScaleInvariantMSCSANet
from completion.networks.mscsa_sfm_kernels import halve_points
from completion.networks.recurrent_norm import fold_batch_norm
from completion.networks.registry import build_model
from haustra.core.errors import CompletionError
from pipeline.depth.sparse_depth import SparseDepth

# Median relative difference of depth between bfloat16 and float32, of the shipped weights on a rendered-like frame.
BFLOAT16_TOLERANCE = 0.01


@pytest.fixture(scope="module")
def frames():
    """Three tube-like frames, shaded by distance, with 80, 300 and no points: rgb, sparse depth, sparse error."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:96, :128] / 96 - 0.5
    rgb, sparse = np.zeros((3, 96, 128, 3), np.uint8), np.zeros((3, 96, 128), np.float32)
    for index, points in enumerate((80, 300, 0)):
        depth = 8 / np.maximum(np.hypot(x - 0.2 * index, y), 0.08)
        rgb[index] = np.clip(3e4 / depth**2 + rng.normal(0, 4, depth.shape), 0, 255)[..., None]
        chosen = rng.choice(depth.size, points, replace=False)
        sparse[index].flat[chosen] = depth.flat[chosen]
    return rgb, sparse, np.where(sparse > 0, rng.uniform(0, 0.1, sparse.shape), 0).astype(np.float32)


@pytest.fixture(scope="module")
def completer():
    return DepthCompleter.load("mscsa", precision="fp32")


def test_a_batch_is_its_frames(completer, frames):
    depth, confidence = completer.batch(*frames)
    assert (depth[2] == 0).all()
    assert (confidence[2] == 0).all()
    for index in range(3):
        one, sure = completer(*(array[index] for array in frames))
        np.testing.assert_allclose(depth[index], one, rtol=1e-4)
        np.testing.assert_allclose(confidence[index], sure, atol=1e-4)


def test_bfloat16_agrees_with_float32_to_the_stated_tolerance(completer, frames):
    rgb, sparse, _ = frames
    exact = completer.batch(rgb[:2], sparse[:2])[0]
    rounded = DepthCompleter.load("mscsa", precision="bf16").batch(rgb[:2], sparse[:2])[0]
    difference = np.abs(rounded / exact - 1)
    assert 0 < np.median(difference) < BFLOAT16_TOLERANCE


@pytest.mark.parametrize("factor", [0.013, 7, 1000])
def test_the_shipped_model_is_scale_equivariant(completer, frames, factor):
    """To single precision's rounding, both iterations; what bfloat16 rounds may fall to the other side."""
    rgb, sparse = (array[1] for array in frames[:2])
    np.testing.assert_allclose(completer(rgb, factor * sparse)[0], factor * completer(rgb, sparse)[0], rtol=1e-5)
    half = DepthCompleter.load("mscsa", precision="bf16")
    off = np.abs(half(rgb, factor * sparse)[0] / (factor * half(rgb, sparse)[0]) - 1)
    assert np.median(off) < 1e-3
    assert off.max() < 0.03


def test_a_point_that_is_said_to_be_wrong_is_listened_to_less(completer, frames, monkeypatch):
    monkeypatch.setattr(completer_module, "towards_points", lambda depth, *_: depth)  # by the network, that is
    rgb, sparse, _ = (array[1] for array in frames)
    rows, columns = np.nonzero(sparse)
    wrong, error = sparse.copy(), np.where(sparse > 0, 0.01, 0).astype(np.float32)
    wrong[rows[::10], columns[::10]] *= 2
    truth = completer(rgb, sparse)[0]
    believed = np.abs(np.log(completer(rgb, wrong, error)[0] / truth)).mean()
    error[rows[::10], columns[::10]] = 0.7
    assert np.abs(np.log(completer(rgb, wrong, error)[0] / truth)).mean() < 0.8 * believed


def test_beyond_the_edge_of_an_odd_sized_image_lies_its_last_row_not_black(frames):
    rgb = torch.from_numpy(frames[0][:1, :90, :100]).permute(0, 3, 1, 2).float() / 255
    sparse = torch.from_numpy(frames[1][:1, None, :90, :100])
    trust = (sparse > 0).float()
    log_sparse = torch.where(sparse > 0, torch.log(sparse.clamp_min(1e-3) / 20), 0.0)
    by_hand = torch.from_numpy(np.pad(rgb.numpy(), ((0, 0), (0, 0), (0, 6), (0, 28)), mode="edge"))
    around = [torch.nn.functional.pad(x, (0, 28, 0, 6)) for x in (log_sparse, trust)]
    network = load_depth_network("mscsa")
    with torch.inference_mode():
        for got, whole in zip(network(rgb, log_sparse, trust), network(by_hand, *around), strict=True):
            torch.testing.assert_close(got, whole[..., :90, :100])


def test_what_cannot_be_completed_is_one_sentence(completer, frames):
    rgb, sparse, error = frames
    with pytest.raises(CompletionError, match="sparse error must have"):
        completer(rgb[0], sparse[0], error[0][:50])
    with pytest.raises(CompletionError, match="no image"):
        completer.batch(rgb[:0], sparse[:0])
    with pytest.raises(CompletionError, match="auto, int8, bf16 or fp32"):
        DepthCompleter(load_depth_network("mscsa"), precision="bfloat16")
    for precision in ("fp32", "bf16", "auto"):
        with pytest.raises(CompletionError, match="folded already"):
            DepthCompleter(DepthCompleter.load("mscsa", precision=precision).network)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 200))
def test_the_order_of_the_points_does_not_matter(seed, points):
    rng = np.random.default_rng(seed)
    pixels = rng.uniform(0, 24, (points, 2))  # many share a pixel
    depth, error = rng.uniform(1, 50, points), rng.uniform(0, 0.2, points)
    order = rng.permutation(points)
    given_order = SparseDepth(pixels, depth, error).maps(24, 24)
    shuffled = SparseDepth(pixels[order], depth[order], error[order]).maps(24, 24)
    for a, b in zip(given_order, shuffled, strict=True):
        np.testing.assert_array_equal(a, b)


def test_halved_points_are_the_trusted_mean_of_their_block():
    values, trust = torch.zeros(1, 1, 4, 4), torch.zeros(1, 1, 4, 4)
    values[..., 0, 0], trust[..., 0, 0] = 1.0, 0.9
    values[..., 1, 1], trust[..., 1, 1] = 4.0, 0.3
    values[..., 3, 2], trust[..., 3, 2] = -2.0, 0.5
    mean, weight = halve_points(values, trust)
    torch.testing.assert_close(mean[0, 0], torch.tensor([[(0.9 + 1.2) / 1.2, 0.0], [0.0, -2.0]]))
    torch.testing.assert_close(weight[0, 0], torch.tensor([[0.9, 0.0], [0.0, 0.5]]))


@pytest.mark.parametrize("name", ["mscsa", "unet+sa", "unet+msc"])
def test_attention_features_are_what_goes_in_and_comes_out(name):
    torch.manual_seed(0)
    network = build_model(name, "small").eval()
    rgb, sparse = torch.rand(2, 3, 64, 64), torch.rand(2, 1, 64, 64)
    found = attention_features(network, lambda: network(rgb, sparse))
    assert (found is None) == (name == "unet+msc")
    if found is not None:
        before, after = found
        assert before.shape == after.shape == (96, 2, 2)
        torch.testing.assert_close(network.unet.attention(before[None])[0], after)


@pytest.mark.slow  # every day: the export of `networks/test_plug_in.py`
@pytest.mark.parametrize("recurrent", [False, True])
def test_onnx_gives_what_torch_gives_for_any_batch(tmp_path, frames, recurrent):
    import onnx
    import onnxruntime

    path = export_onnx(load_depth_network("mscsa"), tmp_path / "m.onnx", 64, recurrent)
    assert onnx.load(path).doc_string == DESCRIPTION + RECURRENT_USE
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    network = load_depth_network("mscsa")
    rgb = torch.from_numpy(frames[0][:, :64, :64]).permute(0, 3, 1, 2).float() / 255
    sparse = torch.from_numpy(frames[1][:, None, :64, :64])
    trust = (sparse > 0).float()
    log_sparse = torch.where(sparse > 0, torch.log(sparse.clamp_min(1e-3) / 20), 0.0)
    for count in (1, 3):
        inputs = {"rgb": rgb[:count], "log_sparse": log_sparse[:count], "trust": trust[:count]}
        with torch.inference_mode():
            expected = network(*inputs.values())
            if recurrent:
                inputs |= dict(zip(LAST, expected, strict=True))
                expected = network(rgb[:count], log_sparse[:count], trust[:count], expected)
        got = session.run(None, {name: tensor.numpy() for name, tensor in inputs.items()})
        for a, b in zip(got, expected, strict=True):
            np.testing.assert_allclose(a, b.numpy(), atol=1e-4)


def test_onnx_refuses_what_it_cannot_do(tmp_path):
    with pytest.raises(CompletionError, match="multiple of 32"):
        export_onnx(load_depth_network("mscsa"), tmp_path / "m.onnx", 100)
    with pytest.raises(CompletionError, match="one iteration"):
        export_onnx(ScaleInvariantMSCSANet(ScaleInvariantConfig(width=4)), tmp_path / "m.onnx", 64, recurrent=True)


def test_the_shipped_header_says_what_was_trained():
    from completion.networks.checkpoint import read_metadata
    from completion.weights.shipped_weights import resolve_weights

    about = read_metadata(resolve_weights("mscsa"))
    assert about["network"] == "ScaleInvariantMSCSANet"
    assert about["training"]["model"] == "mscsa-sfm"
    assert about["steps"] == about["training"]["steps"]
    assert resolve_weights("mscsa").stat().st_size < 20e6


@pytest.mark.parametrize("dtype", [torch.float32, pytest.param(torch.bfloat16, marks=pytest.mark.slow)])
def test_fused_convolutions_are_the_same_function(dtype):
    """Each against its convolution and ReLU, with weights as trained; a copy is the same again."""
    if not can_fuse(dtype):
        pytest.skip("this PyTorch or processor has no fused convolutions")
    plain = fold_batch_norm(load_depth_network("mscsa")).unet.to(dtype, memory_format=torch.channels_last)
    fused = copy.deepcopy(plain)
    fuse_convolutions(fused)
    pairs = 0
    for block, again in zip(double_convs(plain), double_convs(copy.deepcopy(fused)), strict=True):
        for index in (0, 3):
            conv, together = block[index], again[index]
            assert isinstance(together, FusedConvReLU)
            for height, width in ((8, 8), (30, 30), (20, 16), (12, 5), (8, 8), (9, 14)):  # more than are kept
                x = torch.randn(2, conv.in_channels, height, width).to(dtype)
                with torch.inference_mode():
                    expected = conv(x).relu()
                    assert expected.std() > 0
                    tolerance = (1e-5 if dtype == torch.float32 else 0.01) * expected.float().std().item()
                    torch.testing.assert_close(together(x), expected, atol=tolerance, rtol=0.01)
            pairs += 1
    assert pairs == 18
    assert fused.state_dict().keys() >= {"head.weight", "encoder.0.0.conv.weight", "decoder.3.3.conv.bias"}


def double_convs(network):
    return [module for module in network.modules() if isinstance(module, DoubleConv)]


def test_without_fused_convolutions_the_completer_does_without(monkeypatch, frames):
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: False)
    plain = DepthCompleter.load("mscsa", precision="bf16")
    assert not any(isinstance(module, FusedConvReLU) for module in plain.network.modules())
    monkeypatch.undo()
    rgb, sparse, _ = (array[0] for array in frames)
    difference = np.abs(plain(rgb, sparse)[0] / DepthCompleter.load("mscsa", precision="bf16")(rgb, sparse)[0] - 1)
    assert np.median(difference) < BFLOAT16_TOLERANCE


@pytest.mark.parametrize("sparse", [object(), None, [[1.0]]])
def test_what_is_no_depth_map_is_refused(sparse):
    completer = DepthCompleter(load_depth_network("mscsa"), device="cpu", precision="fp32")
    with pytest.raises(CompletionError, match=r"sparse depth must have the image's size \(64, 64\), not \("):
        completer(np.zeros((64, 64, 3), np.uint8), sparse)


def test_one_iteration_and_a_refinement_with_the_same_points_are_two_iterations(frames, monkeypatch):
    monkeypatch.setattr(completer_module, "towards_points", lambda depth, *_: depth)  # what follows the network
    network, (rgb, sparse, error) = load_depth_network("mscsa"), frames
    once, twice = (DepthCompleter(network, "cpu", "fp32", iterations=count) for count in (1, 2))
    for index in (0, 1):
        first = once(rgb[index], sparse[index], error[index])
        refined = once.refine(rgb[index], sparse[index], error[index], *first)
        for got, wanted in zip(refined, twice(rgb[index], sparse[index], error[index]), strict=True):
            np.testing.assert_allclose(got, wanted, rtol=2e-3, atol=2e-3)


def test_a_refinement_follows_points_that_the_first_depth_had_not(frames):
    """Told that the right half is a fifth farther, by points as sure as can be, the network moves that half alone."""
    completer, (rgb, sparse, error) = DepthCompleter.load("mscsa", "cpu", "fp32"), frames
    depth, confidence = completer(rgb[1], sparse[1], error[1])
    points, sure = sparse[1].copy(), np.where(sparse[1] > 0, np.float32(0.02), np.float32(0))
    points[4::8, 68::8] = 1.2 * depth[4::8, 68::8]
    points[:, 64:][sparse[1][:, 64:] > 0] *= 1.2
    sure[points > 0] = 0.002
    moved = completer.refine(rgb[1], points, sure, depth, confidence)[0] / depth
    assert np.median(moved[:, 80:]) == pytest.approx(1.2, abs=0.06)
    assert np.median(moved[:, :48]) == pytest.approx(1.0, abs=0.06)


def test_a_network_of_one_iteration_refuses_to_refine(frames):
    completer = DepthCompleter(ScaleInvariantMSCSANet(ScaleInvariantConfig(width=4)), "cpu", "fp32")
    assert not completer.can_refine
    with pytest.raises(CompletionError, match="iteration"):
        completer.refine(frames[0][0], frames[1][0], frames[2][0], frames[1][0], frames[2][0])


def test_dark_images_are_brightened_and_burnt_ones_are_not_dimmed():
    burnt = np.full((8, 8, 3), 240, np.uint8)
    np.testing.assert_array_equal(normalise_exposure(burnt), burnt)
    np.testing.assert_array_equal(normalise_exposure(np.full((8, 8, 3), 100, np.uint8)), 130)
    np.testing.assert_array_equal(normalise_exposure(np.full((8, 8, 3), 30, np.uint8)), 60)
