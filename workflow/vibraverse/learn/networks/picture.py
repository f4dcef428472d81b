"""The picture network: VGG-16 (Simonyan and Zisserman 2015) to a vector, or a small network of the same kind."""

from __future__ import annotations

import torch
from torch import nn

#: Mean and deviation of the pictures that published weights were trained on.
_MEAN, _DEVIATION = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)

#: Convolutions of the small network, for presets below the published one.
SMALL = (16, "M", 32, "M", 64, "M", 64)


class PictureNetwork(nn.Module):
    """Pictures (B, px, px, 3), 0 to 255, to vectors (B, width).

    ``channels`` lists the convolutions' channels and "M" where the picture is halved; None is VGG-16.
    """

    def __init__(self, width: int, channels: tuple[int | str, ...] | None = None):
        super().__init__()
        if channels is None:
            from torchvision.models import vgg16_bn

            self.features, last = vgg16_bn(weights=None).features, 512
        else:
            parts: list[nn.Module] = []
            before = 3
            for after in channels:
                if after == "M":
                    parts.append(nn.MaxPool2d(2))
                    continue
                parts += [nn.Conv2d(before, after, 3, padding=1), nn.GroupNorm(4, after), nn.ReLU()]
                before = after
            self.features, last = nn.Sequential(*parts), before
        self.head = nn.Linear(last, width)
        self.register_buffer("mean", torch.tensor(_MEAN).view(1, 3, 1, 1))
        self.register_buffer("deviation", torch.tensor(_DEVIATION).view(1, 3, 1, 1))

    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        """Return (B, width)."""
        values = pictures.permute(0, 3, 1, 2).to(self.mean.dtype) / 255.0
        found = self.features((values - self.mean) / self.deviation)
        return self.head(found.mean(dim=(2, 3)))
