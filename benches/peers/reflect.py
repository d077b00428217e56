"""Units of the depth decoders: convolutions over a reflected border."""

import torch.nn.functional as F
from torch import nn


class ReflectConv(nn.Module):
    """3x3 convolution over a reflected border."""

    def __init__(self, inputs, outputs):
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3)

    def forward(self, x):
        return self.conv(F.pad(x, (1, 1, 1, 1), mode="reflect"))


class Unit(nn.Module):
    """A `ReflectConv` with ELU, under the name it has in the checkpoints."""

    def __init__(self, inputs, outputs):
        super().__init__()
        self.conv = ReflectConv(inputs, outputs)

    def forward(self, x):
        return F.elu(self.conv(x), inplace=True)
