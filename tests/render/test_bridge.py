"""Images and their derivatives as torch sees them, against finite differences and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image
from render_shapes import loaded, lumpy, seamless
from scipy.ndimage import binary_erosion, gaussian_filter

from genmf_mi.assets import asset
from genmf_mi.core.frame import Frame
from genmf_mi.mesh import solid
from genmf_mi.render import bridge, variant
from genmf_mi.render.scene import View

VIEWS = (View(20, 10), View(150, -25))


def with_seams(folder) -> tuple[np.ndarray, np.ndarray]:
    """A textured sphere whose vertices are split along a meridian and at the poles, through a file and the welding."""
    rows, columns = 40, 80
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    theta, angle = np.pi * v.ravel(), 2 * np.pi * (u.ravel() % 1)
    directions = np.stack([np.sin(theta) * np.cos(angle), np.cos(theta), np.sin(theta) * np.sin(angle)], axis=1)
    corner = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    right, below = corner + 1, corner + columns + 1
    faces = np.concatenate([np.stack([corner, right, below], axis=1), np.stack([right, below + 1, below], axis=1)])
    mesh = trimesh.Trimesh(lumpy(directions), faces, process=False)
    picture = Image.fromarray((np.indices((8, 8)).sum(0) % 2 * 255).astype(np.uint8))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=picture)
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.stack([u.ravel(), 1 - v.ravel()], axis=1), material=material)
    path = folder / "seams.glb"
    path.write_bytes(mesh.export(file_type="glb"))
    loaded = asset.load(path)
    welded = solid.solidify(loaded.name, loaded.vertices, loaded.faces)
    assert len(welded.vertices) <= len(loaded.vertices) - rows
    return Frame.of(welded.vertices, 100.0).normalise(welded.vertices), welded.faces


@pytest.fixture(scope="module", params=["seamless", "with seams"])
def shape(request, tmp_path_factory):
    """Scene, vertices, faces, and smooth random weights on the pixels well inside of the outline in both views."""
    variant.use("cpu")
    folder = tmp_path_factory.mktemp("shape")
    vertices, faces = seamless() if request.param == "seamless" else with_seams(folder)
    part = loaded(folder, vertices, faces)
    seen = bridge.render(part, VIEWS)
    inside = np.stack([binary_erosion(mask > 0.999, iterations=3) for mask in seen.coverage[:, 0].numpy()])
    noise = np.random.default_rng(0).standard_normal((2, 5, 96, 96))
    weights = gaussian_filter(noise, (0, 0, 5, 5)) * inside[:, None]
    return part, torch.tensor(vertices, dtype=torch.float32), faces, torch.tensor(weights / weights.std())


def sums(seen: bridge.Buffers, weights: torch.Tensor) -> list[torch.Tensor]:
    """Weighted sums of grey, depth and normal."""
    return [(image.double() * weights[:, channels]).sum() for image, channels in
            ((seen.grey, slice(0, 1)), (seen.depth, slice(1, 2)), (seen.normal, slice(2, 5)))]  # fmt: skip


def motions(vertices: torch.Tensor) -> dict[str, torch.Tensor]:
    towards_first_view = torch.tensor([0.34, 0.17, 0.93])
    centre = vertices[(vertices @ towards_first_view).argmax()]
    away = ((vertices - centre) ** 2).sum(dim=1, keepdim=True)
    zero = torch.zeros_like(vertices[:, 0])
    return {
        "bump": torch.exp(-away / 0.05) * torch.nn.functional.normalize(vertices, dim=1),
        "shear": torch.stack([vertices[:, 1], zero, zero], dim=1),
        "translation x": torch.tensor([1.0, 0.0, 0.0]).expand_as(vertices),
        "translation z": torch.tensor([0.0, 0.0, 1.0]).expand_as(vertices),
    }


@pytest.mark.parametrize("name", ["bump", "shear", "translation x", "translation z"])
def test_gradient_against_finite_differences(shape, name):
    """Two views in one call, pixels inside of the outline, the same rays throughout."""
    part, vertices, _, weights = shape
    motion, step = motions(vertices)[name], 2e-3
    with torch.no_grad():
        ahead = torch.stack(sums(bridge.render(part, VIEWS, vertices + step * motion), weights))
        behind = torch.stack(sums(bridge.render(part, VIEWS, vertices - step * motion), weights))
    expected = (ahead - behind) / (2 * step)
    for number, buffer in enumerate(("grey", "depth", "normal")):
        moved = vertices.clone().requires_grad_()
        sums(bridge.render(part, VIEWS, moved), weights)[number].backward()
        assert (moved.grad * motion).sum().item() == pytest.approx(expected[number].item(), rel=0.02), buffer


@pytest.mark.parametrize("finer", [5, 3], ids=["more faces", "fewer faces"])
def test_other_faces(tmp_path, finer):
    """Buffers of any other size: the images of a scene that was loaded with them, and their finite differences."""
    variant.use("cpu")
    part = loaded(tmp_path, *seamless())
    other = trimesh.creation.icosphere(finer)
    vertices, faces = lumpy(other.vertices), torch.tensor(np.asarray(other.faces))
    fresh = bridge.render(loaded(tmp_path, vertices, other.faces), VIEWS)
    vertices = torch.tensor(vertices, dtype=torch.float32)
    bridge.render(part, VIEWS, 0.9 * torch.tensor(seamless()[0], dtype=torch.float32))
    seen = bridge.render(part, VIEWS, vertices, faces)
    assert seen.coverage.sum().item() == pytest.approx(fresh.coverage.sum().item(), rel=0.01)

    inside = np.stack([binary_erosion(mask > 0.999, iterations=3) for mask in seen.coverage[:, 0].numpy()])
    noise = np.random.default_rng(1).standard_normal((2, 5, 96, 96))
    weights = torch.tensor(gaussian_filter(noise, (0, 0, 5, 5)) * inside[:, None])
    motion, step = motions(vertices)["bump"], 2e-3
    with torch.no_grad():
        ahead = torch.stack(sums(bridge.render(part, VIEWS, vertices + step * motion, faces), weights))
        behind = torch.stack(sums(bridge.render(part, VIEWS, vertices - step * motion), weights))
    expected = (ahead - behind) / (2 * step)
    for number in range(3):
        moved = vertices.clone().requires_grad_()
        sums(bridge.render(part, VIEWS, moved, faces), weights)[number].backward()
        assert (moved.grad * motion).sum().item() == pytest.approx(expected[number].item(), rel=0.02)

    before, back = seamless(), loaded(tmp_path, *seamless())
    again = bridge.render(part, VIEWS, torch.tensor(before[0], dtype=torch.float32), torch.tensor(before[1]))
    torch.testing.assert_close(again.grey, bridge.render(back, VIEWS).grey, rtol=0, atol=1e-5)


def test_views_of_one_call_add_up(shape):
    """Each view's gradient belongs to its own camera and lights, though the scene moves on before the backward pass."""
    part, vertices, _, weights = shape
    views = [View(20, 10, (30.0, -20.0)), VIEWS[1]]
    together, apart = (vertices.clone().requires_grad_() for _ in range(2))
    sum(sums(bridge.render(part, views, together, seed=5), weights)).backward()
    for view, weight in zip(views, weights, strict=True):
        sum(sums(bridge.render(part, [view], apart, seed=5), weight[None])).backward()
    torch.testing.assert_close(together.grad, apart.grad, rtol=1e-3, atol=1e-3 * apart.grad.abs().max().item())


def test_stale_derivatives_are_refused(shape):
    """Dr.Jit would give the derivative at the wrong place, or none, without a word."""
    part, vertices, _, _ = shape
    moved = vertices.clone().requires_grad_()
    first = bridge.render(part, VIEWS[:1], moved)
    with torch.no_grad():
        bridge.render(part, VIEWS[:1], 1.01 * vertices)
    with pytest.raises(RuntimeError, match="moved since"):
        first.grey.sum().backward()

    seen = bridge.render(part, VIEWS[:1], moved)
    seen.grey.sum().backward(retain_graph=True)
    with pytest.raises(RuntimeError, match="propagated before"):
        seen.depth.sum().backward()


def test_same_rays_for_the_same_seed(shape):
    part, vertices, _, _ = shape
    first, again, other = (bridge.render(part, VIEWS, vertices, seed=seed).grey for seed in (3, 3, 4))
    # Normals are sums over faces in any order
    assert (first - again).abs().max() < 1e-5
    assert (first - other).abs().max() > 0.01
    coarse = bridge.render(part, VIEWS, vertices, seed=3, samples=1)
    assert not set(coarse.coverage.unique().tolist()) - {0.0, 1.0}


def test_without_vertices_the_object_stays(shape):
    part, vertices, _, _ = shape
    moved = bridge.render(part, VIEWS, 0.9 * vertices)
    for name, image in vars(bridge.render(part, VIEWS)).items():
        torch.testing.assert_close(image, getattr(moved, name), rtol=0, atol=1e-5)
    assert not torch.equal(bridge.render(part, VIEWS, vertices).coverage, moved.coverage)


def test_buffers_have_the_promised_shapes(shape):
    part, vertices, _, _ = shape
    seen = bridge.render(part, VIEWS, vertices)
    assert seen.grey.shape == seen.depth.shape == seen.coverage.shape == (2, 1, 96, 96)
    assert seen.normal.shape == (2, 3, 96, 96)
    assert all(x.dtype == torch.float32 for x in vars(seen).values())
    outside = seen.coverage == 0
    assert 0.2 < outside.float().mean() < 0.8
    assert seen.grey[outside].abs().max() == seen.depth[outside].abs().max() == 0
    length = seen.normal.norm(dim=1, keepdim=True)[seen.coverage == 1]
    assert length.min() > 0.9 and length.max() < 1 + 1e-5


def test_no_ray_slips_through(shape):
    """A ray between two triangles would show the back of the far side: a mean normal much shorter than one."""
    part, vertices, _, _ = shape
    views = [View(azimuth, 20) for azimuth in range(0, 360, 15)]
    for seed in range(4):
        seen = bridge.render(part, views, vertices, seed=seed)
        inside = -torch.nn.functional.max_pool2d(-seen.coverage, 7, 1, 3) > 0.8
        assert seen.coverage[inside].min() == 1
        assert seen.normal.norm(dim=1, keepdim=True)[inside].min() > 0.93


def test_no_geometry_buffers_with_silhouettes(shape, tmp_path):
    _, vertices, faces, _ = shape
    part = loaded(tmp_path, vertices.numpy(), faces, silhouettes=True)
    seen = bridge.render(part, VIEWS, vertices)
    assert seen.grey.shape == (2, 1, 96, 96)
    assert seen.depth is seen.normal is seen.coverage is None
    with pytest.raises(ValueError, match="silhouettes"):
        _ = seen.geometry


def test_silhouettes_add_the_derivative_of_the_outline(shape, tmp_path):
    """The sum over all pixels under a translation along the image: only the outline's share lets it match."""
    _, vertices, faces, _ = shape
    part = loaded(tmp_path, vertices.numpy(), faces, silhouettes=True, samples=64)
    weight = torch.linspace(-1, 1, 96).double()
    motion, step = torch.tensor([1.0, 0, 0]).expand_as(vertices), 1e-2

    def weighted_sum(moved):
        return (bridge.render(part, [View(0, 0)], moved).grey.double() * weight).sum()

    with torch.no_grad():
        expected = (weighted_sum(vertices + step * motion) - weighted_sum(vertices - step * motion)) / (2 * step)
    moved = vertices.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(weighted_sum(moved), moved)
    assert (gradient * motion).sum().item() == pytest.approx(expected.item(), rel=0.03)


def test_on_the_gpu(tmp_path):
    """The same image and gradient from both backends."""
    if not variant.cuda_available():
        pytest.skip("no CUDA device is visible to both torch and Dr.Jit")
    vertices, faces = seamless()
    results = {}
    for device in ("cpu", "cuda"):
        variant.use(device)
        part = loaded(tmp_path, vertices, faces)
        moved = torch.tensor(vertices, dtype=torch.float32, device=device, requires_grad=True)
        seen = bridge.render(part, VIEWS, moved)
        (seen.grey.square().sum() + seen.depth.sum() + seen.normal.square().sum()).backward()
        results[device] = seen.grey.detach().cpu(), moved.grad.cpu()
    variant.use("cpu")
    torch.testing.assert_close(results["cuda"][0], results["cpu"][0], rtol=0, atol=1e-3)
    scale = results["cpu"][1].abs().max().item()
    torch.testing.assert_close(results["cuda"][1], results["cpu"][1], rtol=1e-2, atol=1e-2 * scale)
