"""A second look: which points it gets, what it may not touch, and how a reduced picture's depth is enlarged again."""

from functools import partial

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from completion import DepthCompleter
from completion.confidence import error_from_confidence
from completion.errors import CompletionError
from completion.feedback import look_again, with_own_points
from completion.infer import _enlarged, load_scale_free
from completion.look_norm import fold_batch_norm
from completion.scale_free import ScaleFreeConfig, ScaleFreeMSCSANet
from completion.tasks import ScaleFreeTask
from completion.train_config import make_config


def some_points(seed, height=64, width=96, points=60):
    """rgb, log sparse depth and trust, (1,C,H,W)."""
    rng = np.random.default_rng(seed)
    log_sparse, trust = np.zeros((2, 1, 1, height, width), np.float32)
    chosen = rng.choice(height * width, points, replace=False)
    log_sparse.flat[chosen] = rng.normal(0, 0.3, points)
    trust.flat[chosen] = rng.uniform(0.1, 1, points)
    rgb = rng.random((1, 3, height, width), dtype=np.float32)
    return tuple(map(torch.from_numpy, (rgb, log_sparse, trust)))


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    network = ScaleFreeMSCSANet(ScaleFreeConfig(width=4)).eval()
    for name, buffer in network.named_buffers():
        if name.endswith("again_mean"):
            buffer.normal_()  # else a later look could not be told from a first one
    return network


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 20), st.data())
def test_own_points_are_the_estimate_on_a_grid_and_measured_ones_stay(seed, step, data):
    first = data.draw(st.integers(0, step - 1))
    _, log_sparse, trust = (x.numpy()[0, 0] for x in some_points(seed))
    rng = np.random.default_rng(seed)
    estimate, log_error = rng.normal(size=(2, 64, 96)).astype(np.float32)
    tensors = (torch.from_numpy(x)[None, None] for x in (log_sparse, trust, estimate, log_error))
    got, got_trust = (x.numpy()[0, 0] for x in with_own_points(*tensors, step, first))
    for row in range(64):
        for column in range(96):
            on_grid = row % step == first and column % step == first
            here = (row, column)
            if trust[here] > 0 or not on_grid:
                assert (got[here], got_trust[here]) == (log_sparse[here], trust[here])
            else:
                assert got[here] == estimate[here]
                np.testing.assert_allclose(error_from_confidence(got_trust[here]), np.exp(log_error[here]), rtol=0.01)


def test_each_look_takes_the_measured_points_and_only_the_last_estimate(network):
    rgb, log_sparse, trust = some_points(1)
    with torch.inference_mode():
        seen, later = [network(rgb, log_sparse, trust)], partial(network, again=True)
        for _ in range(2):
            seen.append(later(rgb, *with_own_points(log_sparse, trust, *seen[-1])))
        for looks, by_hand in enumerate(seen, start=1):
            for got, expected in zip(look_again(network, later, rgb, log_sparse, trust, looks), by_hand, strict=True):
                torch.testing.assert_close(got, expected)


def statistics(network):
    """Running statistics of the first look and of later ones."""
    state = network.state_dict()
    return tuple({n: t.clone() for n, t in state.items() if f".{word}_" in n} for word in ("running", "again"))


def test_each_look_learns_and_uses_statistics_of_its_own():
    torch.manual_seed(0)
    network = ScaleFreeMSCSANet(ScaleFreeConfig(width=4)).train()
    features = []
    network.unet.encoder[0][0].register_forward_hook(lambda *call: features.append(call[2].detach()))
    for again in (False, True):
        before = statistics(network)
        network(*some_points(3 + again), again=again)
        after = statistics(network)
        assert all(torch.equal(t, after[not again][n]) for n, t in before[not again].items())
        assert not any(torch.equal(t, after[again][n]) for n, t in before[again].items())
        reference = torch.nn.BatchNorm2d(4)  # torch's own, on what went in
        reference(features[-1])
        for learnt, expected in zip(
            after[again].values(), (reference.running_mean, reference.running_var), strict=False
        ):
            torch.testing.assert_close(learnt, expected)
    network.eval()
    inputs = some_points(6)
    with torch.inference_mode():
        for again in (False, True):
            for got, expected in zip(
                fold_batch_norm(network, again)(*inputs), network(*inputs, again=again), strict=True
            ):
                torch.testing.assert_close(got, expected, atol=1e-4, rtol=1e-4)
        assert not torch.equal(network(*inputs)[0], network(*inputs, again=True)[0])


def test_weights_from_before_there_were_two_statistics_use_theirs_for_both():
    torch.manual_seed(1)
    network = ScaleFreeMSCSANet(ScaleFreeConfig(width=4)).train()
    network(*some_points(4))
    old = {name: tensor for name, tensor in network.state_dict().items() if ".again_" not in name}
    other = ScaleFreeMSCSANet(ScaleFreeConfig(width=4))
    other.load_state_dict(old)
    first, later = statistics(other)
    for (name, mean), (_, same) in zip(first.items(), later.items(), strict=True):
        assert torch.equal(mean, old[name])
        assert torch.equal(mean, same)
    with pytest.raises(RuntimeError, match="running_mean"):
        other.load_state_dict({name: tensor for name, tensor in old.items() if "encoder.0.1" not in name})


def test_training_draws_how_many_looks_came_before_and_does_not_train_through_them():
    task = ScaleFreeTask(make_config(shards=("none",), out="none", width=4))
    rgb, log_sparse, trust = some_points(2)
    counts = set()
    for seed in range(12):
        seen, seen_trust = task._earlier_looks(rgb, log_sparse, trust, torch.Generator().manual_seed(seed))
        again, _ = task._earlier_looks(rgb, log_sparse, trust, torch.Generator().manual_seed(seed))
        assert not seen.requires_grad
        assert torch.equal(seen_trust > 0, (seen_trust > 0) | (trust > 0))
        assert torch.equal(seen != log_sparse, again != log_sparse)
        counts.add(int((seen_trust > 0).sum()))
    assert int((trust > 0).sum()) in counts  # nothing came before
    assert len(counts) > 3  # grids differ


def test_the_look_that_is_judged_trains_every_parameter_whatever_came_before():
    """The earlier looks run without gradients in the same autocast, which keeps converted weights."""
    torch.manual_seed(0)
    task = ScaleFreeTask(make_config(shards=("none",), out="none", width=4))
    rgb, _, _ = some_points(5)
    depth = 20 + 10 * torch.rand(1, 1, 64, 96)
    for seed in range(4):
        task.network.zero_grad()
        task.loss(rgb, depth, None, torch.Generator().manual_seed(seed)).backward()
        assert all(parameter.grad is not None for parameter in task.network.parameters())


def test_two_looks_of_the_completer_are_not_one_and_neither_touches_the_scale():
    rng = np.random.default_rng(0)
    rgb = rng.integers(20, 230, (96, 96, 3), dtype=np.uint8)
    sparse = np.where(rng.random((96, 96)) < 0.02, rng.uniform(20, 40, (96, 96)), 0).astype(np.float32)
    network = load_scale_free("mscsa-twice")
    once, twice = (DepthCompleter(network, precision="fp32", looks=looks) for looks in (1, 2))
    assert np.abs(np.log(once(rgb, sparse)[0] / twice(rgb, sparse)[0])).max() > 1e-3
    np.testing.assert_allclose(twice(rgb, 7 * sparse)[0], 7 * twice(rgb, sparse)[0], rtol=1e-4)
    both_first = DepthCompleter(network, precision="fp32", looks=2)
    both_first.later = both_first.network
    assert np.abs(np.log(both_first(rgb, sparse)[0] / twice(rgb, sparse)[0])).max() > 1e-3
    with pytest.raises(CompletionError, match="at least 1"):
        DepthCompleter(network, looks=0)


def test_the_size_worked_at_follows_the_number_of_points_where_there_is_one_look():
    rng = np.random.default_rng(0)
    rgb = rng.integers(20, 230, (2, 400, 320, 3), dtype=np.uint8)
    sparse = np.zeros((2, 400, 320), np.float32)
    for index, points in enumerate((100, 1000)):
        sparse[index].flat[rng.choice(400 * 320, points, replace=False)] = rng.uniform(10, 50, points)
    network = load_scale_free("mscsa")
    for looks, sides in ((1, (224, 320)), (2, (320, 320))):
        mixed = DepthCompleter(network, precision="fp32", looks=looks).batch(rgb, sparse)[0]
        for index, side in enumerate(sides):
            fixed = DepthCompleter(network, precision="fp32", working_side=side, looks=looks)
            np.testing.assert_allclose(mixed[index], fixed(rgb[index], sparse[index])[0], rtol=1e-3)


def test_a_larger_picture_is_completed_at_the_working_size():
    rng = np.random.default_rng(0)
    rgb = rng.integers(20, 230, (400, 320, 3), dtype=np.uint8)
    sparse = np.zeros((400, 320), np.float32)
    sparse.flat[rng.choice(400 * 320, 300, replace=False)] = rng.uniform(10, 50, 300)
    completer = DepthCompleter(load_scale_free("mscsa"), precision="fp32", working_side=100)
    seen = []
    completer.network.register_forward_pre_hook(lambda module, given: seen.append(given[0].shape[2:]))
    depth, confidence = completer(rgb, sparse)
    assert set(seen) == {(100, 80)}
    assert depth.shape == confidence.shape == (400, 320)


@settings(max_examples=30, deadline=None)
@given(st.integers(8, 40), st.integers(8, 40), st.floats(1.05, 4), st.integers(2, 6))
def test_between_the_two_sides_of_an_edge_no_depth_is_invented(height, width, zoom, column):
    depth = np.full((height, width), 20, np.float32)
    depth[:, column:] = 40
    size = round(width * zoom), round(height * zoom)
    enlarged, _ = _enlarged(depth, np.ones_like(depth), size)
    assert enlarged.shape == (size[1], size[0])
    assert set(np.unique(enlarged)) == {20, 40}
    # The edge is where it was, to half a pixel of the small picture.
    assert abs((enlarged[0] == 20).sum() / zoom - column) <= 0.5 + 1 / zoom


def test_a_slope_is_enlarged_as_a_slope():
    rows, columns = np.mgrid[:30, :40].astype(np.float32)
    plane = 50 + 0.5 * columns + 0.3 * rows
    enlarged, _ = _enlarged(plane, plane, (100, 75))
    y, x = (np.mgrid[:75, :100] + 0.5) * 0.4 - 0.5  # pixel centres in the small picture
    inside = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(enlarged[inside], (50 + 0.5 * x + 0.3 * y)[inside], rtol=1e-4)
