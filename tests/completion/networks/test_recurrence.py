"""Recurrent iterations: what each takes of the one before, and what it may not touch."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from completion import DepthCompleter
from completion.confidence import error_from_confidence
from completion.inference.completer import load_depth_network
from completion.networks.mscsa_sfm import ScaleInvariantConfig, ScaleInvariantMSCSANet
from completion.networks.protocol import Estimate, SampleGrid
from completion.networks.recurrence import refine_iteratively, self_conditioned_input
from completion.networks.recurrent_norm import fold_batch_norm
from completion.training.config import make_config
from completion.training.tasks import make_task
from haustra.core.errors import CompletionError


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
    network = ScaleInvariantMSCSANet(ScaleInvariantConfig(width=4, iterations=3)).eval()
    for name, buffer in network.named_buffers():
        if name.endswith("again_mean"):
            buffer.normal_()  # else a recurrent iteration could not be told from the first
    return network


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 20), st.data())
def test_own_points_are_the_estimate_on_a_grid_and_measured_ones_stay(seed, step, data):
    first = data.draw(st.integers(0, step - 1))
    _, log_sparse, trust = (x.numpy()[0, 0] for x in some_points(seed))
    rng = np.random.default_rng(seed)
    estimate, log_error = rng.normal(size=(2, 64, 96)).astype(np.float32)
    points, weights, *last = (torch.from_numpy(x)[None, None] for x in (log_sparse, trust, estimate, log_error))
    got = self_conditioned_input(points, weights, Estimate(*last), SampleGrid(step, first))
    got, got_trust = (x.numpy()[0, 0] for x in got)
    for row in range(64):
        for column in range(96):
            on_grid = row % step == first and column % step == first
            here = (row, column)
            if trust[here] > 0 or not on_grid:
                assert (got[here], got_trust[here]) == (log_sparse[here], trust[here])
            else:
                assert got[here] == estimate[here]
                np.testing.assert_allclose(error_from_confidence(got_trust[here]), np.exp(log_error[here]), rtol=0.01)


def test_each_iteration_takes_the_measured_points_and_only_the_last_estimate():
    asked = []

    def stub(name):
        return lambda *inputs: asked.append((name, *inputs)) or f"estimate {len(asked)}"

    assert refine_iteratively(stub("first"), stub("recurrent"), "image", "points", "trust", 3) == "estimate 3"
    given = ("image", "points", "trust")
    assert asked == [("first", *given, None), ("recurrent", *given, "estimate 1"), ("recurrent", *given, "estimate 2")]


def test_a_recurrent_iteration_is_given_the_whole_estimate_and_which_points_were_measured(network):
    """Channels of the U-Net's input at half resolution, against what they mean."""
    rgb, log_sparse, trust = some_points(7)
    rng = np.random.default_rng(7)
    last = Estimate(*(torch.from_numpy(x) for x in rng.normal(size=(2, 1, 1, 64, 96)).astype(np.float32)))
    seen = []
    hook = network.unet.register_forward_pre_hook(lambda module, given: seen.append(given[0]))
    with torch.inference_mode():
        network(rgb, log_sparse, trust)
        network(rgb, log_sparse, trust, last)
    hook.remove()
    first, later = seen
    assert (first[:, 20:] == 0).all()
    assert torch.equal(first[:, :16], later[:, :16])  # the image
    spread = torch.nn.functional.interpolate(later[:, 16:17], scale_factor=2, mode="bilinear")
    difference = torch.nn.functional.pixel_shuffle(later[:, 20:24], 2) + spread
    torch.testing.assert_close(difference, last.log_depth)
    blocks = last.log_error.numpy().reshape(32, 2, 48, 2).mean((1, 3))
    np.testing.assert_allclose(later[0, 24], blocks / 6, rtol=1e-4, atol=1e-6)
    assert torch.equal(first[:, 18:20], later[:, 25:27])  # the measured points alone
    assert (later[:, 19:20] > 0).sum() > 2 * (later[:, 26:27] > 0).sum()  # own ones are among all points


def test_the_margin_of_an_odd_size_has_no_points_of_its_own(network):
    rgb, log_sparse, trust = (x[..., :60, :70] for x in some_points(10))
    last = Estimate(torch.randn(1, 1, 60, 70), torch.full((1, 1, 60, 70), -4.0))
    inputs = []
    hook = network.msc.register_forward_pre_hook(lambda module, given: inputs.append(given))
    with torch.inference_mode():
        made = network(rgb, log_sparse, trust, last)
    hook.remove()
    assert made.log_depth.shape == (1, 1, 60, 70)
    points = inputs[0][1][0, 0] > 0
    assert points.shape == (32, 48)
    assert points[:30, :35].sum() > 40
    assert not points[30:].any()
    assert not points[:, 35:].any()


def test_only_measured_points_correct_the_sum(network):
    rgb, log_sparse, trust = some_points(8)
    last = Estimate(torch.randn(1, 1, 64, 96), torch.full((1, 1, 64, 96), -4.0))
    inputs = []
    hook = network.anchor.register_forward_pre_hook(lambda module, given: inputs.append(given[2:4]))
    with torch.inference_mode():
        network(rgb, log_sparse, trust, last)
    hook.remove()
    assert torch.equal(inputs[0][0], log_sparse)
    assert torch.equal(inputs[0][1], trust)


def test_a_network_trained_for_one_iteration_takes_no_estimate():
    network = ScaleInvariantMSCSANet(ScaleInvariantConfig(width=4)).eval()
    rgb, log_sparse, trust = some_points(9)
    with torch.inference_mode():
        estimate = network(rgb, log_sparse, trust)
        with pytest.raises(CompletionError, match="one iteration"):
            network(rgb, log_sparse, trust, estimate)
    with pytest.raises(CompletionError, match="trained for 1 iterations at most"):
        DepthCompleter(network, iterations=2)


def statistics(network):
    """Running statistics of the first iteration and of recurrent ones."""
    state = network.state_dict()
    return tuple({n: t.clone() for n, t in state.items() if f".{word}_" in n} for word in ("running", "again"))


def test_each_kind_of_iteration_learns_and_uses_statistics_of_its_own():
    torch.manual_seed(0)
    network = ScaleInvariantMSCSANet(ScaleInvariantConfig(width=4, iterations=2)).train()
    features = []
    network.unet.encoder[0][0].register_forward_hook(lambda *call: features.append(call[2].detach()))
    last = Estimate(torch.randn(1, 1, 64, 96), torch.full((1, 1, 64, 96), -2.0))
    for again in (False, True):
        before = statistics(network)
        network(*some_points(3 + again), last if again else None)
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
    for name, buffer in network.named_buffers():
        if name.endswith("again_mean"):
            buffer.normal_()  # one step alone teaches them little
    with torch.inference_mode():
        for again in (False, True):
            inputs = (*some_points(6), last if again else None)
            for got, expected in zip(fold_batch_norm(network, again)(*inputs), network(*inputs), strict=True):
                torch.testing.assert_close(got, expected, atol=1e-4, rtol=1e-4)
        # The wrong statistics would be noticed.
        assert not torch.allclose(fold_batch_norm(network)(*inputs)[0], network(*inputs)[0], atol=1e-2)


def test_weights_without_recurrent_statistics_are_refused():
    torch.manual_seed(1)
    network = ScaleInvariantMSCSANet(ScaleInvariantConfig(width=4, iterations=2))
    for word in ("again_", "running_"):
        with pytest.raises(RuntimeError, match=word):
            network.load_state_dict({n: t for n, t in network.state_dict().items() if f".{word}" not in n})


def test_training_draws_how_many_iterations_came_before_and_does_not_train_through_them():
    task = make_task(make_config(shards=("none",), out="none", width=4))
    calls = []
    task.network.register_forward_hook(lambda *call: calls.append(call))
    inputs = some_points(2, 32, 64, points=30)
    drawn, grids = set(), set()
    for seed in range(24):
        calls.clear()
        last, grid = task._earlier_iterations(*inputs, torch.Generator().manual_seed(seed))
        drawn.add(len(calls))
        assert (last is None) == (not calls)
        again, same = task._earlier_iterations(*inputs, torch.Generator().manual_seed(seed))
        assert grid == same
        assert 0 <= grid.first < grid.step
        if last is not None:
            assert not last.log_depth.requires_grad
            assert torch.equal(last.log_depth, again.log_depth)
        grids.add(grid)
    assert drawn == {0, 1, 2}
    assert len(grids) > 10


@pytest.mark.slow
def test_the_iteration_that_is_judged_trains_every_parameter_whatever_came_before():
    """The earlier iterations run without gradients in the same autocast, which keeps converted weights."""
    torch.manual_seed(0)
    task = make_task(make_config(shards=("none",), out="none", width=4))
    rgb, _, _ = some_points(5, 32, 64, points=30)
    depth = 20 + 10 * torch.rand(1, 1, 32, 64)
    for seed in range(4):
        task.network.zero_grad()
        task.loss(rgb, depth, None, torch.Generator().manual_seed(seed)).backward()
        assert all(parameter.grad is not None for parameter in task.network.parameters())


def test_two_iterations_of_the_completer_are_not_one_and_neither_touches_the_scale():
    rng = np.random.default_rng(0)
    rgb = rng.integers(20, 230, (64, 64, 3), dtype=np.uint8)
    sparse = np.where(rng.random((64, 64)) < 0.02, rng.uniform(20, 40, (64, 64)), 0).astype(np.float32)
    network = load_depth_network("mscsa")
    once, twice = (DepthCompleter(network, precision="fp32", iterations=iterations) for iterations in (1, 2))
    second = twice(rgb, sparse)[0]
    assert np.abs(np.log(once(rgb, sparse)[0] / second)).max() > 1e-3
    np.testing.assert_allclose(twice(rgb, 7 * sparse)[0], 7 * second, rtol=1e-4)
    both_first = DepthCompleter(network, precision="fp32", iterations=2)
    both_first.recurrent = both_first.network
    assert np.abs(np.log(both_first(rgb, sparse)[0] / second)).max() > 1e-3
    with pytest.warns(DeprecationWarning, match="iterations="):
        assert DepthCompleter(network, precision="fp32", looks=1).iterations == 1
    with pytest.warns(DeprecationWarning, match="iterations="):
        assert DepthCompleter.load("mscsa", precision="fp32", looks=3).iterations == 3
    with pytest.raises(CompletionError, match="at least 1"):
        DepthCompleter(network, iterations=0)
