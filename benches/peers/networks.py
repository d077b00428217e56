"""Depth and pose networks of Monodepth2, ResNet encoders with their decoders, in any size; Lite-Mono and RAFT beside them.

Parameters have the names of the reference checkpoints, in four files: `encoder`, `depth`, `pose_encoder`, `pose`. Sums and
activations are in place where torchvision and Monodepth2 have them so: everywhere but in the pose decoder.
"""

import torch
import torch.nn.functional as F
from torch import nn

import lite_mono
import scene
from raft import Raft
from reflect import ReflectConv, Unit
from store import memory_format


class BasicBlock(nn.Module):
    """Two 3x3 convolutions with batch norm around a skip connection."""

    def __init__(self, inputs, outputs, stride):
        super().__init__()
        self.conv1, self.bn1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs)
        self.conv2, self.bn2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False), nn.BatchNorm2d(outputs)
        self.downsample = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))

    def forward(self, x):
        y = F.relu(self.bn1(self.conv1(x)), inplace=True)
        y = self.bn2(self.conv2(y))
        y += x if self.downsample is None else self.downsample(x)
        return F.relu(y, inplace=True)


class ResNet(nn.Module):
    """Features at 1/2 to 1/32 of the size: `widths` of the stem and the four layers, `blocks` in each layer.

    `classifier` is the layer behind them that nobody asks here: checkpoints have it.
    """

    def __init__(self, images, widths, blocks, classifier=False):
        super().__init__()
        self.conv1, self.bn1 = nn.Conv2d(3 * images, widths[0], 7, 2, 3, bias=False), nn.BatchNorm2d(widths[0])
        for i in range(4):
            first = BasicBlock(widths[i], widths[i + 1], 1 if i == 0 else 2)
            more = (BasicBlock(widths[i + 1], widths[i + 1], 1) for _ in range(blocks[i] - 1))
            setattr(self, f"layer{i + 1}", nn.Sequential(first, *more))
        if classifier:
            self.fc = nn.Linear(widths[4], 1000)

    def forward(self, images):
        features = [F.relu(self.bn1(self.conv1((images - 0.45) / 0.225)), inplace=True)]
        x = F.max_pool2d(features[0], 3, 2, 1)
        for layer in (self.layer1, self.layer2, self.layer3, self.layer4):
            x = layer(x)
            features.append(x)
        return features


def resnet18_widths(width):
    """Channels of a ResNet-18 with `width` in its stem; 64 is the usual one."""
    return [width, width, 2 * width, 4 * width, 8 * width]


class DepthDecoder(nn.Module):
    """Five levels of unit, nearest doubling, skip connection, unit; a disparity on the four finest."""

    def __init__(self, encoder, widths):
        super().__init__()
        units, heads = [], [ReflectConv(widths[i], 1) for i in range(4)]
        for i in range(4, -1, -1):
            units.append(Unit(encoder[4] if i == 4 else widths[i + 1], widths[i]))
            units.append(Unit(widths[i] + (encoder[i - 1] if i > 0 else 0), widths[i]))
        self.decoder = nn.ModuleList(units + heads)

    def forward(self, features):
        """Disparities, finest first."""
        x, disparities = features[4], []
        for i in range(4, -1, -1):
            x = F.interpolate(self.decoder[2 * (4 - i)](x), scale_factor=2, mode="nearest")
            if i > 0:
                x = torch.cat([x, features[i - 1]], 1)
            x = self.decoder[2 * (4 - i) + 1](x)
            if i < 4:
                disparities.append(torch.sigmoid(self.decoder[10 + i](x)))
        return disparities[::-1]


class PoseDecoder(nn.Module):
    """Four convolutions, mean over the map, factor 0.01: rotation vector and translation for each of `frames`."""

    def __init__(self, inputs, width, frames=1):
        super().__init__()
        pad = [(inputs, width, 1, 0), (width, width, 3, 1), (width, width, 3, 1), (width, 6 * frames, 1, 0)]
        self.net = nn.ModuleList(nn.Conv2d(ci, co, k, 1, p) for ci, co, k, p in pad)

    def forward(self, x):
        for conv in self.net[:3]:
            x = F.relu(conv(x))
        return 0.01 * self.net[3](x).mean((2, 3))


class Encoder(nn.Module):
    """A ResNet under the name that it has in the checkpoints."""

    def __init__(self, images, widths, blocks=(2, 2, 2, 2), classifier=False):
        super().__init__()
        self.encoder = ResNet(images, widths, blocks, classifier)

    def forward(self, images):
        return self.encoder(images)


def share_parameters(store, modules):
    """Makes the parameters of modules, by file name, inputs of the case: the first variant's fresh ones, the same for all."""
    for file, module in modules.items():
        for name, parameter in module.named_parameters():
            fresh = parameter.detach().clone().numpy()
            with torch.no_grad():
                parameter.copy_(store.input(f"{file}:{name}", tuple(parameter.shape), lambda rng, fresh=fresh: fresh))


def depth_network(sizes):
    """Modules by file name, and what they say of two images: of a ResNet, or of Lite-Mono where the sizes have `dims`."""
    if "dims" in sizes:
        encoder, decoder = lite_mono.Encoder(sizes), lite_mono.Decoder(sizes["dims"])
        return {"encoder": encoder, "depth": decoder}, lambda first, second: decoder(encoder(first))
    encoder = Encoder(**sizes["encoder"])
    decoder = DepthDecoder(sizes["encoder"]["widths"], sizes["decoder"])
    return {"encoder": encoder, "depth": decoder}, lambda first, second: decoder(encoder(first))


def pose_network(sizes):
    """The same; rotation vector and translation of the first of the frames, with the factors of the configuration."""
    encoder = Encoder(**sizes["encoder"])
    decoder = PoseDecoder(sizes["encoder"]["widths"][4], sizes["decoder"], sizes["frames"])
    scale = torch.tensor(sizes["scale"])

    def run(first, second):
        return (decoder(encoder(torch.cat([first, second], 1))[4])[:, :6] * scale).split(3, 1)

    return {"pose_encoder": encoder, "pose": decoder}, run


def flow_network(sizes):
    """The same."""
    net = Raft(sizes)
    return {"raft": net}, net


# Networks by the role that they have.
MAKERS = {"depth": depth_network, "pose": pose_network, "flow": flow_network}


def build(case, variant, store):
    """A whole network in training: forward, and forward with backward from the sum of all outputs.

    `case`: name, shape of the images, sizes with `net` (depth, pose or flow).
    """
    shape, sizes = tuple(case["images"]), case["sizes"]
    fmt = memory_format(variant["layout"])
    torch.manual_seed(1)
    modules, run = MAKERS[sizes["net"]](sizes)
    share_parameters(store, modules)
    for module in modules.values():
        module.train().to(memory_format=fmt)
    target, _, following = (x.contiguous(memory_format=fmt) for x in scene.images(store, shape[0], *shape[2:]))

    def forward():
        with torch.no_grad():
            return run(target, following)

    def forward_backward():
        for module in modules.values():
            module.zero_grad(set_to_none=True)
        outputs = run(target, following)
        sum(output.sum() for output in outputs).backward()
        return outputs

    for i, output in enumerate(forward_backward()):
        store.result(f"y{i}", output)
    for file, module in modules.items():
        for name, parameter in module.named_parameters():
            gradient = torch.zeros_like(parameter) if parameter.grad is None else parameter.grad
            store.result(f"grad_{file}:{name}", gradient)
    return {"forward": forward, "forward_backward": forward_backward}, {}
