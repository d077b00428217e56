"""Lite-Mono in any size: convolutions with growing dilation, attention over channels, a small decoder.

Parameters have the names of the reference checkpoints, in two files: `encoder` and `depth`. Channels come last where layers act
on them alone, as in the reference. No path is dropped.
"""

import math

import torch
import torch.nn.functional as F
from torch import nn

from reflect import ReflectConv, Unit

# Channels of the sines and cosines of one axis, and the base of their wave lengths.
WAVES, BASE = 32, 10000.0


class Conv(nn.Module):
    """A convolution under the name that it has in the checkpoints."""

    def __init__(self, inputs, outputs, stride=1, dilation=1, groups=1):
        super().__init__()
        self.conv = nn.Conv2d(inputs, outputs, 3, stride, dilation, dilation, groups, bias=False)

    def forward(self, x):
        return self.conv(x)


class Stem(Conv):
    """The same, then batch norm and GELU."""

    def __init__(self, inputs, outputs, stride=1):
        super().__init__(inputs, outputs, stride)
        self.bn_gelu = nn.Module()
        self.bn_gelu.bn = nn.BatchNorm2d(outputs)

    def forward(self, x):
        return F.gelu(self.bn_gelu.bn(self.conv(x)))


class Perceptron(nn.Module):
    """Two linear layers over the channels with a GELU between them, and a factor for each channel."""

    def __init__(self, width, expansion):
        super().__init__()
        self.norm = nn.LayerNorm(width, eps=1e-6)
        self.pwconv1, self.pwconv2 = nn.Linear(width, expansion * width), nn.Linear(expansion * width, width)
        self.gamma = nn.Parameter(torch.full((width,), 1e-6))

    def mix(self, x):
        """[..., c] -> [..., c]."""
        return self.gamma * self.pwconv2(F.gelu(self.pwconv1(x)))


class Dilated(Perceptron):
    """Depth-wise convolution with a dilation, batch norm, perceptron, skip connection. The layer norm is there and never used."""

    def __init__(self, width, dilation, expansion):
        super().__init__(width, expansion)
        self.ddwconv, self.bn1 = Conv(width, width, 1, dilation, width), nn.BatchNorm2d(width)

    def forward(self, x):
        y = self.bn1(self.ddwconv(x)).permute(0, 2, 3, 1)
        return x + self.mix(y).permute(0, 3, 1, 2)


class ChannelAttention(nn.Module):
    """Attention between the channels of each head; queries and keys have length 1 along the pixels."""

    def __init__(self, width, heads):
        super().__init__()
        self.heads, self.temperature = heads, nn.Parameter(torch.ones(heads, 1, 1))
        self.qkv, self.proj = nn.Linear(width, 3 * width), nn.Linear(width, width)

    def forward(self, x):
        n, tokens, c = x.shape
        q, k, v = self.qkv(x).reshape(n, tokens, 3, self.heads, c // self.heads).permute(2, 0, 3, 4, 1)
        attention = F.normalize(q, dim=-1) @ F.normalize(k, dim=-1).transpose(-2, -1) * self.temperature
        mixed = attention.softmax(dim=-1) @ v
        return self.proj(mixed.permute(0, 3, 1, 2).reshape(n, tokens, c))


class PositionalCode(nn.Module):
    """Sines and cosines of row and column, projected to the channels."""

    def __init__(self, width):
        super().__init__()
        self.token_projection = nn.Conv2d(2 * WAVES, width, 1)

    def forward(self, h, w):
        def code(size):
            angle = (torch.arange(size) + 1) / (size + 1e-6) * 2 * math.pi
            k = torch.arange(WAVES)
            angle = angle[:, None] / BASE ** (2 * (k // 2) / WAVES)
            return torch.where(k % 2 == 0, angle.sin(), angle.cos())

        rows, columns = code(h)[:, None].expand(h, w, WAVES), code(w)[None].expand(h, w, WAVES)
        return self.token_projection(torch.cat([rows, columns], 2).permute(2, 0, 1)[None])


class Attended(Perceptron):
    """Channel attention and perceptron; the block's input is what they are added to."""

    def __init__(self, width, heads, expansion, positional):
        super().__init__(width, expansion)
        self.norm_xca, self.gamma_xca = nn.LayerNorm(width, eps=1e-6), nn.Parameter(torch.full((width,), 1e-6))
        self.xca = ChannelAttention(width, heads)
        if positional:
            self.pos_embd = PositionalCode(width)

    def forward(self, x):
        n, c, h, w = x.shape
        tokens = x + self.pos_embd(h, w) if hasattr(self, "pos_embd") else x
        tokens = tokens.flatten(2).transpose(1, 2)
        tokens = tokens + self.gamma_xca * self.xca(self.norm_xca(tokens))
        tokens = self.mix(self.norm(tokens))
        return x + tokens.transpose(1, 2).reshape(n, c, h, w)


class Encoder(nn.Module):
    """Features at 1/4, 1/8 and 1/16 of the size.

    `sizes`: dims, dilations (a list for each stage), heads, expansion.
    """

    def __init__(self, sizes):
        super().__init__()
        dims = sizes["dims"]
        first = nn.Sequential(Stem(3, dims[0], 2), Stem(dims[0], dims[0]), Stem(dims[0], dims[0]))
        down = [nn.Sequential(Conv(2 * dims[i] + 3, dims[i + 1], 2)) for i in range(2)]
        self.downsample_layers = nn.ModuleList([first, *down])
        self.stem2 = nn.Sequential(Conv(dims[0] + 3, dims[0], 2))
        self.stages = nn.ModuleList()
        for i, dilations in enumerate(sizes["dilations"]):
            blocks = [Dilated(dims[i], d, sizes["expansion"]) for d in dilations]
            self.stages.append(nn.Sequential(*blocks, Attended(dims[i], sizes["heads"], sizes["expansion"], i == 0)))

    def forward(self, images):
        images = (images - 0.45) / 0.225
        pooled = [F.avg_pool2d(images, 3, 2, 1)]
        for _ in range(2):
            pooled.append(F.avg_pool2d(pooled[-1], 3, 2, 1))
        x = self.stem2(torch.cat([self.downsample_layers[0](images), pooled[0]], 1))
        features = [self.stages[0](x)]
        for i in (1, 2):
            x = self.downsample_layers[i](torch.cat([x, features[-1], pooled[i]], 1))
            features.append(self.stages[i](x))
        return features


class Decoder(nn.Module):
    """Three levels of unit, bilinear doubling, skip connection, unit; a disparity on each, doubled before its sigmoid."""

    def __init__(self, dims):
        super().__init__()
        widths = [c // 2 for c in dims]
        units = []
        for i in (2, 1, 0):
            units.append(Unit(dims[2] if i == 2 else widths[i + 1], widths[i]))
            units.append(Unit(widths[i] + (dims[i - 1] if i > 0 else 0), widths[i]))
        self.decoder = nn.ModuleList(units + [ReflectConv(widths[i], 1) for i in range(3)])

    def forward(self, features):
        """Disparities, finest first."""
        x, disparities = features[2], []
        for i in (2, 1, 0):
            x = double(self.decoder[2 * (2 - i)](x))
            if i > 0:
                x = torch.cat([x, features[i - 1]], 1)
            x = self.decoder[2 * (2 - i) + 1](x)
            disparities.append(torch.sigmoid(double(self.decoder[6 + i](x))))
        return disparities[::-1]


def double(x):
    """Twice the size, bilinear."""
    return F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)
