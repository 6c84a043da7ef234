"""UpProj, NLSPN's propagation and GAENet's geometric encoding against literal loops and finite differences."""

import numpy as np
import pytest
import torch
import torch.nn.functional as F

from completion.networks.rivals.gaenet import GAENet, GAENetConfig, JointDecoder, PointEmbedding, back_project
from completion.networks.rivals.nlspn import NonLocalPropagation
from completion.networks.rivals.sparse_to_dense import UnpoolConv, UpProj


@pytest.fixture(autouse=True)
def seeded():
    torch.manual_seed(0)


def randomise_norms(module):
    """Running statistics as after training: an untrained batch normalisation is the identity and hides mistakes."""
    for part in module.modules():
        if isinstance(part, (torch.nn.BatchNorm1d, torch.nn.BatchNorm2d)):
            part.running_mean.normal_()
            part.running_var.uniform_(0.5, 2)
            part.weight.data.uniform_(0.5, 1.5)
            part.bias.data.normal_()
    return module.eval()


def literal_unpool_conv(x, kernel):
    """Zeros between the pixels, then a "same" 5x5 correlation, one output at a time."""
    channels, height, width = x.shape
    unpooled = np.zeros((channels, 2 * height + 4, 2 * width + 4))
    for c in range(channels):
        for i in range(height):
            for j in range(width):
                unpooled[c, 2 + 2 * i, 2 + 2 * j] = x[c, i, j]
    out = np.zeros((len(kernel), 2 * height, 2 * width))
    for o, i, j in np.ndindex(*out.shape):
        out[o, i, j] = (unpooled[:, i : i + 5, j : j + 5] * kernel[o]).sum()
    return out


def released_kernel(module):
    """(out,in,5,5) of the convolution that follows the unpooling."""
    return module.weight.detach().flip(2, 3).transpose(0, 1).numpy()


def test_unpool_conv_equals_the_literal_loop():
    layer = UnpoolConv(3, 2).double()
    x = torch.randn(1, 3, 4, 5, dtype=torch.double)
    expected = literal_unpool_conv(x[0].numpy(), released_kernel(layer))
    np.testing.assert_allclose(layer(x)[0].detach().numpy(), expected, atol=1e-12)


def test_upproj_equals_its_two_literal_branches():
    block = randomise_norms(UpProj(4).double())
    x = torch.randn(1, 4, 3, 4, dtype=torch.double)
    wide = torch.tensor(literal_unpool_conv(x[0].numpy(), released_kernel(block.unpool_conv)))[None]
    norm, (conv, last_norm) = block.norm, block.project

    def normalise(values, layer, channels):
        mean, var, gain, bias = (
            getattr(layer, n)[channels].detach().view(1, -1, 1, 1)
            for n in ("running_mean", "running_var", "weight", "bias")
        )
        return (values - mean) / torch.sqrt(var + 1e-5) * gain + bias

    main = F.relu(normalise(wide[:, :2], norm, slice(0, 2)))
    main = normalise(F.conv2d(main, conv.weight, padding=1), last_norm, slice(0, 2))
    expected = F.relu(main + normalise(wide[:, 2:], norm, slice(2, 4)))
    torch.testing.assert_close(block(x), expected, rtol=1e-10, atol=1e-10)


def literal_bilinear(image, y, x):
    """Value at a real-valued place; corners outside of the image are zero."""
    top, left, total = int(np.floor(y)), int(np.floor(x)), 0.0
    for i in (top, top + 1):
        for j in (left, left + 1):
            if 0 <= i < image.shape[0] and 0 <= j < image.shape[1]:
                total += image[i, j] * (1 - abs(y - i)) * (1 - abs(x - j))
    return total


def literal_propagation(depth, predicted, confidence, kind, scale, steps):
    """NLSPN for one image, pixel by pixel: depth (H,W), predicted (24,H,W), confidence (H,W) or None."""
    window = [(-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)]
    for _ in range(steps):
        after = np.zeros_like(depth)
        for i, j in np.ndindex(*depth.shape):
            places = [
                (i + dy + predicted[2 * k, i, j], j + dx + predicted[2 * k + 1, i, j])
                for k, (dy, dx) in enumerate(window)
            ]
            affinity = [float(a) for a in predicted[16:, i, j]]
            if kind in ("TC", "TGASS"):
                affinity = [np.tanh(a) / scale for a in affinity]
            if confidence is not None:
                affinity = [a * literal_bilinear(confidence, *p) for a, p in zip(affinity, places, strict=True)]
            total = sum(abs(a) for a in affinity) + 1e-4
            if kind == "AS" or (kind in ("ASS", "TGASS") and total > 1):
                affinity = [a / total for a in affinity]
            neighbours = [literal_bilinear(depth, *p) for p in places]
            after[i, j] = (1 - sum(affinity)) * depth[i, j] + np.dot(affinity, neighbours)
        depth = after
    return depth


def propagation(kind, steps=3, gamma=0.5, spread=1.0):
    """A layer whose offsets reach a few pixels, the border included."""
    layer = NonLocalPropagation(kind, steps, gamma).double()
    torch.nn.init.normal_(layer.predict.weight, std=0.3 * spread)
    torch.nn.init.normal_(layer.predict.bias, std=spread)
    return layer


@pytest.mark.parametrize("trusted", [False, True])
@pytest.mark.parametrize(("kind", "gamma"), [("AS", 1), ("ASS", 1), ("TC", 1), ("TGASS", 0.5), ("TGASS", 0.1)])
def test_propagation_equals_the_literal_loop(kind, gamma, trusted):
    layer = propagation(kind, gamma=gamma)
    depth, guidance = 1 + torch.rand(2, 1, 5, 7).double(), torch.randn(2, 8, 5, 7).double()
    confidence = torch.rand(2, 1, 5, 7).double() if trusted else None
    got = layer(depth, guidance, confidence).detach().numpy()
    predicted = layer.predict(guidance).detach().numpy()
    scale = {"TC": 8, "TGASS": 8 * gamma}.get(kind, 1)
    for b in range(2):
        trust = confidence[b, 0].numpy() if trusted else None
        expected = literal_propagation(depth[b, 0].numpy(), predicted[b], trust, kind, scale, 3)
        np.testing.assert_allclose(got[b, 0], expected, rtol=1e-7)


def test_propagation_starts_as_the_identity_and_learns_from_there():
    layer = NonLocalPropagation()
    depth, guidance = torch.rand(1, 1, 6, 6), torch.randn(1, 8, 6, 6)
    out = layer(depth, guidance, torch.rand(1, 1, 6, 6))
    torch.testing.assert_close(out, depth)
    (out * torch.randn_like(out)).sum().backward()
    assert (layer.predict.weight.grad[16:] != 0).any()


@pytest.mark.slow
def test_propagation_has_the_gradient_of_finite_differences():
    layer = propagation("TGASS", steps=2)
    depth, guidance, confidence = (torch.rand(1, c, 3, 4).double().requires_grad_() for c in (1, 8, 1))
    assert torch.autograd.gradcheck(lambda d, g: layer(d, g), (depth, guidance))
    # Not the guidance here: the offsets are cut from the confidence on purpose.
    assert torch.autograd.gradcheck(lambda d, c: layer(d, guidance.detach(), c), (depth, confidence))


def test_offsets_are_not_drawn_towards_confident_places():
    """As released: the confidence weighs a neighbour, but moves none."""
    layer = propagation("TGASS")
    _, affinity = layer.neighbourhood(torch.randn(1, 8, 5, 6).double(), torch.rand(1, 1, 5, 6).double())
    affinity.square().sum().backward()
    assert (layer.predict.bias.grad[:16] == 0).all()
    assert (layer.predict.bias.grad[16:] != 0).all()


def test_back_projected_points_project_onto_their_pixel_centres():
    pixels = torch.tensor([[0, 0, 0], [0, 3, 9], [1, 7, 2]])
    intrinsics = torch.tensor([[50.0, 60, 5.5, 4.5], [80.0, 70, 6, 3]])
    depth = torch.tensor([2.0, 30.0, 7.0])
    for (image, row, column), z, (x, y, same) in zip(
        pixels.tolist(), depth.tolist(), back_project(depth, pixels, intrinsics).tolist(), strict=True
    ):
        fx, fy, cx, cy = intrinsics[image].tolist()
        assert same == z
        assert fx * x / z + cx == pytest.approx(column + 0.5, abs=1e-5)
        assert fy * y / z + cy == pytest.approx(row + 0.5, abs=1e-5)


def literal_embedding(points, net):
    """DGCNN of one image: points (n,3) -> (n,features), with a sort for the neighbours and a loop for the maximum."""

    def leaky(values):
        return np.where(values > 0, values, 0.2 * values)

    def norm(values, layer):
        mean, var, gain, bias = (
            getattr(layer, n).detach().numpy() for n in ("running_mean", "running_var", "weight", "bias")
        )
        return (values - mean) / np.sqrt(var + 1e-5) * gain + bias

    x, levels = points, []
    for edge in net.edges:
        weight, out = edge.linear.weight.detach().numpy(), []
        for i in range(len(x)):
            order = np.argsort([((x[j] - x[i]) ** 2).sum() for j in range(len(x))])[: net.k]
            edges = [leaky(norm(weight @ np.concatenate([x[j] - x[i], x[i]]), edge.norm)) for j in order]
            out.append(np.max(edges, axis=0))
        x = np.array(out)
        levels.append(x)
    fused = leaky(norm(np.concatenate(levels, axis=1) @ net.fuse.weight.detach().numpy().T, net.norm))
    group = fused.shape[1] // net.features
    return np.stack([fused[:, g * group : (g + 1) * group].max(axis=1) for g in range(net.features)], axis=1)


def test_point_embedding_equals_the_literal_loop_image_by_image():
    net = randomise_norms(PointEmbedding(features=4, k=5).double())
    counts = [12, 3, 8]  # one with fewer points than neighbours
    points = torch.randn(sum(counts), 3).double()
    got = net(points, counts).detach().numpy()
    expected = [literal_embedding(own.numpy(), net) for own in points.split(counts)]
    np.testing.assert_allclose(got, np.concatenate(expected), rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_point_embedding_has_the_gradient_of_finite_differences():
    net = randomise_norms(PointEmbedding(features=4, k=3).double())
    points = torch.randn(5, 3).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda p: net(p, [5])[:, :2], points)


@pytest.mark.parametrize(("coordinate", "index"), [("z", 2), ("y", 1)])
def test_point_map_holds_each_point_at_its_pixel_and_nothing_else(coordinate, index):
    net = randomise_norms(GAENet(GAENetConfig(base=8, features=4, coordinate=coordinate)))
    sparse = (5 + 20 * torch.rand(2, 1, 24, 32)) * (torch.rand(2, 1, 24, 32) < 0.02)
    intrinsics = torch.tensor([[60.0, 62.0, 16.0, 12.0]]).expand(2, 4)
    sparse[1] = 0
    sparse[1, 0, 5, 6] = 9.0
    got = net.point_map(sparse, intrinsics)
    pixels = (sparse[:, 0] > 0).nonzero()
    points = back_project(sparse[sparse > 0], pixels, intrinsics)
    torch.testing.assert_close(got.permute(0, 2, 3, 1)[sparse[:, 0] > 0][:, 4], points[:, index])
    torch.testing.assert_close(got[1, :4, 5, 6], net.embedding(points[-1:], [1])[0], rtol=1e-4, atol=1e-4)
    assert (got.abs().sum(1) > 0).equal(sparse[:, 0] > 0)


def test_joint_decoder_adds_the_images_maps_and_concatenates_the_points():
    """The released order, written out: both take maps of one shape, so a swap would still run."""
    decoder = randomise_norms(JointDecoder(4))
    image, points = ([torch.randn(1, c, s, s) for c, s in ((4, 16), (8, 8), (16, 4))] for _ in range(2))
    x = decoder.ups[0](torch.cat([image[2], points[2]], dim=1))
    x = decoder.blocks[0](x + image[1])
    x = decoder.ups[1](torch.cat([x, points[1]], dim=1))
    x = decoder.blocks[1](x + image[0])
    expected = decoder.head(torch.cat([x, points[0]], dim=1))
    torch.testing.assert_close(decoder(image, points), expected)
