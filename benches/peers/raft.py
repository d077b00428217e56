"""The small RAFT: two encoders, all-pairs correlation, a convolutional GRU that refines the flow.

Parameters have the names of the reference's checkpoints. Activations are in place where the reference has them so.
"""

import torch
import torch.nn.functional as F
from torch import nn


class Bottleneck(nn.Module):
    """1x1, 3x3 with the stride, 1x1, each with norm and ReLU, around a skip connection."""

    def __init__(self, inputs, outputs, stride, norm):
        super().__init__()
        narrow = outputs // 4
        self.conv1, self.conv2 = nn.Conv2d(inputs, narrow, 1), nn.Conv2d(narrow, narrow, 3, stride, 1)
        self.conv3, self.norm = nn.Conv2d(narrow, outputs, 1), norm
        self.downsample = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride))

    def forward(self, x):
        y = x
        for conv in (self.conv1, self.conv2, self.conv3):
            y = F.relu(self.norm(conv(y)), inplace=True)
        skip = x if self.downsample is None else self.norm(self.downsample(x))
        return F.relu(skip + y, inplace=True)


class Encoder(nn.Module):
    """Features of an image at 1/2 of the size in the stem, then at 1/2, 1/4 and 1/4 or 1/8."""

    def __init__(self, sizes, outputs, norm):
        super().__init__()
        self.conv1, self.norm = nn.Conv2d(3, sizes["stem"], 7, 2, 3), norm
        inputs = sizes["stem"]
        for i, (width, stride) in enumerate(zip(sizes["stages"], (1, 2, sizes["last_stride"]))):
            blocks = Bottleneck(inputs, width, stride, norm), Bottleneck(width, width, 1, norm)
            setattr(self, f"layer{i + 1}", nn.Sequential(*blocks))
            inputs = width
        self.conv2 = nn.Conv2d(inputs, outputs, 1)

    def forward(self, x):
        x = F.relu(self.norm(self.conv1(x)), inplace=True)
        return self.conv2(self.layer3(self.layer2(self.layer1(x))))


class MotionEncoder(nn.Module):
    """Features of the flow and of the correlation at its ends; the flow itself last."""

    def __init__(self, sizes):
        super().__init__()
        wide, narrow = sizes["flow"]
        self.convc1 = nn.Conv2d(sizes["levels"] * (2 * sizes["radius"] + 1) ** 2, sizes["correlation"], 1)
        self.convf1, self.convf2 = nn.Conv2d(2, wide, 7, 1, 3), nn.Conv2d(wide, narrow, 3, 1, 1)
        self.conv = nn.Conv2d(sizes["correlation"] + narrow, sizes["motion"], 3, 1, 1)

    def forward(self, flow, correlation):
        seen, moved = F.relu(self.convc1(correlation)), F.relu(self.convf2(F.relu(self.convf1(flow))))
        return torch.cat([F.relu(self.conv(torch.cat([seen, moved], 1))), flow], 1)


class Gru(nn.Module):
    """A recurrent unit whose gates are 3x3 convolutions."""

    def __init__(self, hidden, inputs):
        super().__init__()
        self.convz, self.convr, self.convq = (nn.Conv2d(hidden + inputs, hidden, 3, 1, 1) for _ in range(3))

    def forward(self, hidden, x):
        both = torch.cat([hidden, x], 1)
        z, r = torch.sigmoid(self.convz(both)), torch.sigmoid(self.convr(both))
        q = torch.tanh(self.convq(torch.cat([r * hidden, x], 1)))
        return (1 - z) * hidden + z * q


class FlowHead(nn.Module):
    """Change of the flow, cells."""

    def __init__(self, hidden, width):
        super().__init__()
        self.conv1, self.conv2 = nn.Conv2d(hidden, width, 3, 1, 1), nn.Conv2d(width, 2, 3, 1, 1)

    def forward(self, x):
        return self.conv2(F.relu(self.conv1(x), inplace=True))


class Update(nn.Module):
    """One refinement."""

    def __init__(self, sizes):
        super().__init__()
        self.encoder = MotionEncoder(sizes)
        self.gru = Gru(sizes["hidden"], sizes["context"] + sizes["motion"] + 2)
        self.flow_head = FlowHead(sizes["hidden"], sizes["head"])

    def forward(self, hidden, context, correlation, flow):
        hidden = self.gru(hidden, torch.cat([context, self.encoder(flow, correlation)], 1))
        return hidden, self.flow_head(hidden)


class Correlation:
    """Inner products of all pixels of two feature maps, halved in the second map level by level."""

    def __init__(self, first, second, levels, radius):
        n, c, h, w = first.shape
        volume = first.reshape(n, c, -1).transpose(1, 2) @ second.reshape(n, c, -1) / c**0.5
        self.pyramid, self.radius = [volume.reshape(n * h * w, 1, h, w)], radius
        for _ in range(levels - 1):
            self.pyramid.append(F.avg_pool2d(self.pyramid[-1], 2))

    def windows(self, ends):
        """Squares around coordinates [n, 2, h, w] on every level; the slow index of a window moves along u."""
        n, _, h, w = ends.shape
        steps = torch.arange(-self.radius, self.radius + 1, dtype=ends.dtype)
        window = torch.stack(torch.meshgrid(steps, steps, indexing="ij"), -1)
        centres, found = ends.permute(0, 2, 3, 1).reshape(-1, 1, 1, 2), []
        for level, volume in enumerate(self.pyramid):
            size = ends.new_tensor([volume.shape[3] - 1, volume.shape[2] - 1])
            grid = 2 * (centres / 2**level + window) / size - 1
            found.append(F.grid_sample(volume, grid, align_corners=True).reshape(n, h, w, -1))
        return torch.cat(found, -1).permute(0, 3, 1, 2).contiguous()


class Raft(nn.Module):
    """Flows in pixels after every refinement, from images in [0, 1]."""

    def __init__(self, sizes):
        super().__init__()
        self.sizes = sizes
        # Without parameters, the same in training and evaluation.
        self.fnet = Encoder(sizes, sizes["features"], F.instance_norm)
        self.cnet = Encoder(sizes, sizes["hidden"] + sizes["context"], nn.Identity())
        self.update_block = Update(sizes)

    def forward(self, first, second):
        sizes, factor = self.sizes, 4 * self.sizes["last_stride"]
        first, second = 2 * first - 1, 2 * second - 1
        correlation = Correlation(*self.fnet(torch.cat([first, second])).chunk(2), sizes["levels"], sizes["radius"])
        hidden, context = self.cnet(first).split([sizes["hidden"], sizes["context"]], 1)
        hidden, context = torch.tanh(hidden), torch.relu(context)
        n, _, h, w = hidden.shape
        v, u = torch.meshgrid(torch.arange(h, dtype=hidden.dtype), torch.arange(w, dtype=hidden.dtype), indexing="ij")
        grid = torch.stack([u, v]).expand(n, 2, h, w)
        flow, flows = torch.zeros_like(grid), []
        for _ in range(sizes["iterations"]):
            flow = flow.detach()
            hidden, change = self.update_block(hidden, context, correlation.windows(grid + flow), flow)
            flow = flow + change
            flows.append(factor * F.interpolate(flow, scale_factor=factor, mode="bilinear", align_corners=True))
        return flows
