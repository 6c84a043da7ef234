"""Random numbers lie where their generator does and are those of torch."""

import pytest
import torch

from completion.data.draws import DeviceGenerator, integer_draw, normal_draws, on_host, uniform_draws

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU"))]


@pytest.mark.parametrize("device", DEVICES)
def test_draws_repeat_by_seed_on_the_device_of_their_generator(device: str) -> None:
    def all_kinds() -> list[torch.Tensor]:
        generator = torch.Generator(device).manual_seed(7)
        drawn = [uniform_draws((3, 500), generator), normal_draws((4, 500), generator)]
        return [*drawn, torch.tensor([integer_draw(5, 9, generator) for _ in range(60)])]

    uniform, normal, integers = all_kinds()
    assert uniform.device.type == normal.device.type == device
    assert 0 <= uniform.min() < 0.01
    assert 0.99 < uniform.max() < 1
    assert abs(normal.mean()) < 0.1
    assert abs(normal.std() - 1) < 0.1
    assert set(integers.tolist()) == {5, 6, 7, 8}
    assert all(torch.equal(one, again) for one, again in zip((uniform, normal, integers), all_kinds(), strict=True))


def test_a_cpus_draws_are_those_that_earlier_trainings_saw() -> None:
    ours, torchs = (torch.Generator().manual_seed(3) for _ in range(2))
    assert torch.equal(uniform_draws((5,), ours), torch.rand(5, generator=torchs))
    assert torch.equal(normal_draws((2, 40), ours), torch.randn(2, 40, generator=torchs))
    assert integer_draw(2, 900, ours) == int(torch.randint(2, 900, (), generator=torchs))


@pytest.mark.parametrize("device", DEVICES)
def test_what_the_cpu_has_to_know_is_drawn_on_the_cpu(device: str) -> None:
    generator, plain = DeviceGenerator.seeded(torch.device(device), 4), torch.Generator().manual_seed(4)
    assert on_host(generator).device.type == "cpu"
    assert on_host(plain) is plain
    first = uniform_draws((6,), generator)
    assert [integer_draw(0, 100, generator) for _ in range(9)] == [integer_draw(0, 100, plain) for _ in range(9)]
    assert torch.equal(uniform_draws((6,), DeviceGenerator.seeded(torch.device(device), 4)), first)
