"""LPIPS for grey images, without torchvision.

Zhang et al., *The Unreasonable Effectiveness of Deep Features as a Perceptual Metric* (CVPR 2018), version 0.1: the
activations of an ImageNet network are normalised to unit length at each pixel, and their squared differences are
weighted per channel, averaged over pixels and summed over layers. AlexNet is cheap enough for a loss; VGG16 is for
evaluation.

Where several images are compared with one reference, compute ``features(reference)`` once and pass it as the
reference.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from genmf_mi.losses import lpips_weights as weights
from genmf_mi.losses.lpips_weights import Network
from genmf_mi.losses.shapes import GreyImages

# The published scaling of an RGB image in [-1, 1]. The shift is mean 0.485, 0.456, 0.406 brought to [-1, 1].
_SHIFT = (-0.030, -0.088, -0.188)
_SCALE = (0.458, 0.448, 0.450)
# Padding of each convolution, and the convolutions that a max pool of (kernel, stride) precedes. AlexNet's first
# convolution has kernel 11 and stride 4; `_blocks` turns it into kernel 3 and stride 1 without padding.
_PADDING = {"alex": (0, 2, 1, 1, 1), "vgg": (1,) * 13}
_POOLED = {"alex": {1: (3, 2), 2: (3, 2)}, "vgg": {2: (2, 2), 4: (2, 2), 7: (2, 2), 10: (2, 2)}}


@dataclass(frozen=True)
class Features:
    """What LPIPS compares: per layer ``[B,C,h,w]``, unit length times the square root of the channel's weight."""

    network: Network
    layers: tuple[Float[Tensor, "B _ _ _"], ...]


def features(image: GreyImages, network: Network = "alex") -> Features:
    """The features of grey images ``[B,1,H,W]`` in 0..1; differentiable with respect to ``image``.

    Raises:
        SetupError: the weights are not installed.
    """
    convolutions, linear = _network(network, image.device)
    layers: list[Tensor] = []
    # The second channel is the constant of the scaling: inside the image it is one, in the zero padding it is not.
    x = torch.cat([image, torch.ones_like(image)], dim=1)
    if network == "alex":
        x = _blocks(x)
    for i, (weight, bias) in enumerate(convolutions):
        if pool := _POOLED[network].get(i):
            x = F.max_pool2d(x, *pool)
        x = F.relu(F.conv2d(x, weight, bias, padding=_PADDING[network][i]))
        if i in weights.TAPS[network]:
            # The published 1e-10 beside the norm, moved under the root so that black regions have a gradient.
            length = torch.rsqrt(x.square().sum(dim=1, keepdim=True) + 1e-20)
            layers.append(x * length * linear[len(layers)])
    return Features(network, tuple(layers))


def lpips(
    image: Float[Tensor, "B 1 H W"] | Features,
    reference: Float[Tensor, "#B 1 H W"] | Features,
    network: Network = "alex",
    mask: Float[Tensor, "#B 1 H W"] | None = None,
) -> Float[Tensor, " _"]:
    """LPIPS of grey images ``[B,1,H,W]`` in 0..1 against a reference of the same size: ``[B]``, 0 for equal images.

    image: may be given by its :func:`features` too.
    reference: images ``[B,1,H,W]``, or their :func:`features` (then their network is used). A batch of 1 is compared
        with every image.
    mask: ``[B,1,H,W]`` in 0..1; each layer's average is then taken inside it (the mask is area-averaged down to the
        layer). None is the published metric, over the full frame.

    Raises:
        SetupError: the weights are not installed.
    """
    if not isinstance(reference, Features):
        reference = features(reference, network)
    if not isinstance(image, Features):
        image = features(image, reference.network)
    layers: list[Tensor] = []
    for ours, theirs in zip(image.layers, reference.layers, strict=True):
        difference = (ours - theirs).square().sum(dim=1)
        if mask is None:
            layers.append(difference.mean(dim=(1, 2)))
        else:
            height, width = difference.shape[1:]
            inside = F.adaptive_avg_pool2d(mask, (height, width))[:, 0]
            layers.append((difference * inside).sum(dim=(1, 2)) / inside.sum(dim=(1, 2)).clamp_min(1e-12))
    total = layers[0]
    for layer in layers[1:]:
        total = total + layer
    return total


def _blocks(x: Float[Tensor, "B 2 H W"]) -> Float[Tensor, "B 32 _ _"]:
    """Images ``[B,2,H,W]``, zero-padded by 2, as blocks of 4 x 4 pixels: ``[B,32,(H+1)//4+1,(W+1)//4+1]``.

    A convolution of stride 4 becomes one of stride 1; its backward pass, the slowest of the network, is 5 times faster.
    """
    height, width = x.shape[2:]
    right, below = (4 * ((n + 1) // 4 + 1) - 2 - n for n in (width, height))
    return F.pixel_unshuffle(F.pad(x, (2, right, 2, below)), 4)


@lru_cache(maxsize=4)
def _network(network: Network, device: torch.device) -> tuple[list[tuple[Tensor, Tensor]], list[Tensor]]:
    """Frozen ``(weight, bias)`` of the convolutions, the first one for (grey, one), and roots of the linear layers."""
    tensors = weights.load(network)
    first = tensors["conv0.weight"]
    # RGB channel c sees (2 grey - 1 - shift_c) / scale_c: a convolution of (grey, one) says the same.
    shift, scale = torch.tensor(_SHIFT).view(1, 3, 1, 1), torch.tensor(_SCALE).view(1, 3, 1, 1)
    grey = (first * 2 / scale).sum(dim=1, keepdim=True)
    one = (first * (-1 - shift) / scale).sum(dim=1, keepdim=True)
    first = torch.cat([grey, one], dim=1)
    tensors["conv0.weight"] = F.pixel_unshuffle(F.pad(first, (0, 1, 0, 1)), 4) if network == "alex" else first
    count = len(_PADDING[network])
    # Channels last takes 10 to 30 % off the time on a CPU, and the same numbers come out.
    kernels = [tensors[f"conv{i}.weight"].to(device, memory_format=torch.channels_last) for i in range(count)]
    convolutions = [(kernel, tensors[f"conv{i}.bias"].to(device)) for i, kernel in enumerate(kernels)]
    linear = [tensors[f"linear{i}"].sqrt().view(1, -1, 1, 1).to(device) for i in range(len(weights.TAPS[network]))]
    return convolutions, linear
