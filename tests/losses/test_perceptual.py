"""LPIPS against its published values, and against the plain formula on random weights."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F
from skimage import data

from genmf_mi.losses import lpips_weights as weights
from genmf_mi.losses import perceptual
from genmf_mi.losses.perceptual import features, lpips

VGG = (3, 64, 64, 128, 128, 256, 256, 256, 512, 512, 512, 512, 512, 512)
# Output channels, input channels and kernel of each convolution.
SHAPES = {
    "alex": [(64, 3, 11), (192, 64, 5), (384, 192, 3), (256, 384, 3), (256, 256, 3)],
    "vgg": [(VGG[i + 1], VGG[i], 3) for i in range(13)],
}


@pytest.fixture
def random_weights(monkeypatch):
    """Random float64 weights in place of the trained ones: nothing to install, and exact finite differences."""

    def load(network: str) -> dict[str, torch.Tensor]:
        generator = torch.Generator().manual_seed(1)
        made = {}
        for i, (o, c, k) in enumerate(SHAPES[network]):
            scale = (2 / (c * k * k)) ** 0.5
            made[f"conv{i}.weight"] = torch.randn(o, c, k, k, generator=generator, dtype=torch.float64) * scale
            made[f"conv{i}.bias"] = torch.randn(o, generator=generator, dtype=torch.float64) * 0.1
        for i, tap in enumerate(weights.TAPS[network]):
            made[f"linear{i}"] = torch.rand(SHAPES[network][tap][0], generator=generator, dtype=torch.float64)
        return made

    monkeypatch.setattr(weights, "load", load)
    perceptual._network.cache_clear()
    yield load
    perceptual._network.cache_clear()


def images(height: int, width: int, count: int = 1, seed: int = 0) -> torch.Tensor:
    return torch.rand(count, 1, height, width, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def oracle(image: torch.Tensor, reference: torch.Tensor, network: str, tensors: dict) -> torch.Tensor:
    """The published formula on RGB, layer by layer."""
    pools = {"alex": {1: 3, 2: 3}, "vgg": {2: 2, 4: 2, 7: 2, 10: 2}}[network]
    shift = torch.tensor([-0.030, -0.088, -0.188]).view(1, 3, 1, 1)
    scale = torch.tensor([0.458, 0.448, 0.450]).view(1, 3, 1, 1)
    x, y = (((2 * grey - 1).expand(-1, 3, -1, -1) - shift) / scale for grey in (image, reference))
    total = 0
    for i, (_, _, kernel) in enumerate(SHAPES[network]):
        stride, padding = (4, 2) if kernel == 11 else (1, kernel // 2)
        layer = tensors[f"conv{i}.weight"], tensors[f"conv{i}.bias"], stride, padding
        if i in pools:
            x, y = F.max_pool2d(x, pools[i], 2), F.max_pool2d(y, pools[i], 2)
        x, y = F.relu(F.conv2d(x, *layer)), F.relu(F.conv2d(y, *layer))
        if i in weights.TAPS[network]:
            unit_x = x / (x.norm(dim=1, keepdim=True) + 1e-10)
            unit_y = y / (y.norm(dim=1, keepdim=True) + 1e-10)
            linear = tensors[f"linear{weights.TAPS[network].index(i)}"].view(1, -1, 1, 1)
            total = total + (linear * (unit_x - unit_y).square()).sum(dim=1).mean(dim=(1, 2))
    return total


@pytest.mark.parametrize(("network", "value"), [("alex", 0.7183188), ("vgg", 0.7237164)])
def test_published_value(network, value):
    if network in weights.missing():
        pytest.skip(f"the LPIPS weights ({network}) are not installed: run `genmf-mi weights`")
    camera, gravel = (torch.from_numpy(image() / 255.0).float()[None, None] for image in (data.camera, data.gravel))
    with torch.no_grad():
        assert lpips(camera, gravel, network).item() == pytest.approx(value, abs=1e-6)
        assert lpips(camera, camera, network).item() == 0


# AlexNet's first convolution is folded into blocks of 4, whose padding depends on the size modulo 4.
@pytest.mark.parametrize(
    ("network", "height", "width"),
    [("alex", 64, 67), ("alex", 65, 66), ("alex", 66, 65), ("alex", 67, 64), ("vgg", 33, 40)],
)
def test_grey_shortcut_equals_rgb(network, height, width, random_weights):
    image, reference = images(height, width, 2, 0), images(height, width, 2, 1)
    with torch.no_grad():
        expected = oracle(image, reference, network, random_weights(network))
        torch.testing.assert_close(lpips(image, reference, network), expected, rtol=1e-6, atol=0)


def test_gradient(random_weights):
    image, reference = images(64, 66, seed=0).requires_grad_(), images(64, 66, seed=1)
    (gradient,) = torch.autograd.grad(lpips(image, reference).sum(), image)
    direction = torch.randn(image.shape, generator=torch.Generator().manual_seed(2), dtype=torch.float64)
    with torch.no_grad():
        step = 1e-6 * direction
        difference = (lpips(image + step, reference) - lpips(image - step, reference)).item() / 2e-6
    assert (gradient * direction).sum().item() == pytest.approx(difference, rel=1e-4)


def test_gradient_where_nothing_is_active(random_weights, monkeypatch):
    def dead(network: str) -> dict[str, torch.Tensor]:
        return random_weights(network) | {"conv0.bias": torch.full((64,), -1e3, dtype=torch.float64)}

    monkeypatch.setattr(weights, "load", dead)
    image = torch.zeros(1, 1, 64, 64, dtype=torch.float64, requires_grad=True)
    (gradient,) = torch.autograd.grad(lpips(image, images(64, 64)).sum(), image)
    assert gradient.isfinite().all()


def test_features_are_reused(random_weights):
    image, reference = images(32, 32, 2, 0), images(32, 32, 1, 1)
    with torch.no_grad():
        prepared = features(reference, "vgg")
        expected = torch.cat([lpips(one[None], reference, "vgg") for one in image])
        torch.testing.assert_close(lpips(image, prepared), expected, rtol=1e-12, atol=0)
        torch.testing.assert_close(lpips(features(image, "vgg"), prepared), expected, rtol=1e-12, atol=0)


def test_mask(random_weights):
    image, reference = images(96, 96, seed=0), images(96, 96, seed=1)
    left = torch.zeros_like(image)
    left[..., :32] = 1
    with torch.no_grad():
        torch.testing.assert_close(lpips(image, reference, mask=torch.ones_like(image)), lpips(image, reference))
        # What differs only far from the mask counts in the full frame alone: AlexNet sees less than 200 pixels.
        wide, other = images(96, 512, seed=0), images(96, 512, seed=0)
        other[..., 300:] = images(96, 212, seed=1)
        left = torch.zeros_like(wide)
        left[..., :64] = 1
        assert lpips(wide, other).item() > 1e-2
        assert lpips(wide, other, mask=left).item() == 0
        assert lpips(wide, other, mask=torch.zeros_like(wide)).item() == 0


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_gpu_agrees_with_cpu(random_weights):
    image, reference = images(64, 64, seed=0), images(64, 64, seed=1)
    with torch.no_grad():
        torch.testing.assert_close(lpips(image.cuda(), reference.cuda()).cpu(), lpips(image, reference))
