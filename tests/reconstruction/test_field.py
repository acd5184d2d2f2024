"""The field's equations against integrals and hand-made figures; that it learns; that a seed makes it again."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.reconstruction.a_plane import NORMAL, OFFSET_M, a_view, some_views

torch = pytest.importorskip("torch", reason="the extra `enhance` is not installed")

from agent.reconstruction.field import (  # noqa: E402
    NEAREST_M,
    Box,
    Bundle,
    Field,
    FieldSettings,
    density,
    learn,
    look,
    loss,
    picture,
    ray_weights,
    through_water,
    trace,
)


def plane_box(cell_m: float = 0.02) -> Box:
    """Distances to the plane of a_plane.py about what its views see."""
    low, count = np.array([-0.5, -0.5, -0.1]), (51, 51, 41)
    places = low + cell_m * np.moveaxis(np.indices(count), 0, -1)
    return Box(tuple(low.tolist()), cell_m, np.clip(places @ NORMAL - OFFSET_M, -0.03, 0.03).astype(np.float32))


def test_density_is_the_distribution_of_laplaces_law() -> None:
    beta = 0.004
    # The density of Laplace's law, summed with 20,000 steps from where it is nothing, is its distribution.
    x = np.linspace(-0.1, 0.1, 20_001)
    law = np.exp(-np.abs(x) / beta) / (2 * beta)
    summed = np.concatenate([[0.0], np.cumsum((law[1:] + law[:-1]) / 2 * (x[1] - x[0]))])
    found = density(torch.tensor(-x), torch.tensor(beta, dtype=torch.float64)).numpy()
    assert found == pytest.approx(summed / beta, abs=2e-3 / beta)


def test_weights_are_what_a_fine_integral_says() -> None:
    """A ray onto a plane: 8 pieces at the middles of 64 fine ones each."""
    beta, near, far = torch.tensor(0.004, dtype=torch.float64), -0.02, 0.02
    fine = near + (torch.arange(512, dtype=torch.float64) + 0.5) * (far - near) / 512
    truth = ray_weights(density(-fine, beta)[None], torch.tensor([[(far - near) / 512]]))[0]
    coarse = near + (torch.arange(8, dtype=torch.float64) + 0.5) * (far - near) / 8
    found = ray_weights(density(-coarse, beta)[None], torch.tensor([[(far - near) / 8]]))[0]
    assert found.sum() == pytest.approx(1.0) and truth.sum() == pytest.approx(1.0)
    assert found.numpy() == pytest.approx(truth.reshape(8, 64).sum(1).numpy(), abs=0.06)
    assert float((found * coarse).sum()) == pytest.approx(float((truth * fine).sum()), abs=5e-4)


def test_water_by_hand() -> None:
    red = [torch.tensor([value], dtype=torch.float64) for value in (0.5, 2.0, 0.3, 0.4, 0.2)]
    colour, t, direct, scatter, veil = red
    by_hand = 0.5 * math.exp(-0.3 * 2.0) + 0.2 * (1 - math.exp(-0.4 * 2.0))
    assert float(through_water(colour, t[0], direct, scatter, veil)) == pytest.approx(by_hand)
    assert float(through_water(colour, torch.tensor(0.0), direct, scatter, veil)) == pytest.approx(0.5)


def test_rays_are_those_of_the_view() -> None:
    views = some_views()
    bundle = Bundle(views, torch.device("cpu"))
    chosen = torch.tensor([0, 161, 19_200 * 3 + 5])
    rays, true = bundle.rays(chosen), bundle.pixels(chosen)
    for n, (view, row, col) in enumerate(((views[0], 0, 0), (views[0], 1, 1), (views[3], 0, 5))):
        from agent.reconstruction.views import surface_points

        t = (true.depth_m[n] - rays.ahead_m[n]) / rays.forward[n]
        found = (rays.origin_m[n] + t * rays.toward[n]).numpy()
        assert found == pytest.approx(surface_points(view)[row, col], abs=1e-5)


def test_rays_meet_the_surface_that_the_field_starts_from() -> None:
    field, view = Field(plane_box(), 0.02, 0.04, seed=0), a_view("r1", 0, (0.0, 0.0, 0.0), (0.1, 0.05, 0.0))
    bundle = Bundle([view], torch.device("cpu"))
    rays = bundle.rays(torch.arange(0, bundle.count, 97))
    met = trace(field, rays, torch.full_like(rays.forward, NEAREST_M), 40)
    z = (rays.ahead_m + met * rays.forward).numpy()
    assert z == pytest.approx(view.depth_m.ravel()[::97], abs=2.5e-3)  # 1.5 mm before it, and cells of 20 mm


def test_gradients_are_those_of_central_differences() -> None:
    field = Field(plane_box(), 0.05, 0.10, seed=1).double()
    view = a_view("r1", 0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    bundle = Bundle([replace(view, depth_m=view.depth_m + np.float32(0.003))], torch.device("cpu"))
    chosen = torch.tensor([4000, 9000])
    rays, true = (type(x)(*(f.double() for f in x)) for x in (bundle.rays(chosen), bundle.pixels(chosen)))
    met = trace(field, rays, torch.full_like(rays.forward, NEAREST_M), 40)
    offsets = torch.full((2, 8), 0.5, dtype=torch.float64)

    def value() -> torch.Tensor:
        return loss(look(field, rays, met - 0.02, met + 0.02, offsets), rays, true, 1.0)

    value().backward()
    for parameter in (field.planes[0], field.lines[2], field.outer.weight, field.water, field.log_beta, field.sdf_m):
        flat, slope = parameter.data.view(-1), parameter.grad.view(-1)
        for k in slope.abs().topk(min(2, len(slope))).indices.tolist():
            h, here = 1e-6, float(flat[k])
            ends = []
            for at in (here + h, here - h):
                flat[k] = at
                ends.append(float(value().detach()))
            flat[k] = here
            assert (ends[0] - ends[1]) / (2 * h) == pytest.approx(float(slope[k]), rel=0.02, abs=1e-8)


def _learnt(steps: int, rays: int, seed: int = 0) -> Field:
    field = Field(plane_box(), 0.004, 0.05, seed=seed)
    settings = FieldSettings(steps=steps, rays=rays, seed=seed)
    for _ in learn(field, some_views(), settings, lambda: 0.0):
        pass
    return field


def test_a_seed_makes_the_same_field_again() -> None:
    a, b, other = _learnt(20, 2), _learnt(20, 2), _learnt(20, 2, seed=1)
    for name, value in a.state_dict().items():
        assert torch.equal(value, b.state_dict()[name])
    assert not torch.equal(a.planes[0], other.planes[0])


def test_it_learns_the_picture_of_a_plane() -> None:
    field, new = _learnt(100, 512), a_view("r9", 0, (0.02, 0.02, 0.0), (0.0, 0.05, 0.0))
    light, depth = picture(field, new)
    error = light ** (1 / 2.2) - new.picture ** (1 / 2.2)
    assert -10 * np.log10(np.mean(error[8:-8, 8:-8] ** 2)) > 24.0
    assert np.median(np.abs(depth - new.depth_m)) < 2e-3
