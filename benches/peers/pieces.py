"""Batch norm and the element-wise and pooling pieces of the networks: forward, and forward with backward."""

import torch
import torch.nn.functional as F

from store import memory_format


def build(case, variant, store):
    """`case`: name, op, and one shape [n, c, h, w] for each input."""
    fmt = memory_format(variant["layout"])
    inputs = [store.normal(f"x{i}", tuple(shape)) for i, shape in enumerate(case["shapes"])]
    inputs = [x.contiguous(memory_format=fmt).requires_grad_() for x in inputs]
    run = OPS[case["op"]](case, store, inputs)
    y = run()
    gy = store.normal("gy", tuple(y.shape)).contiguous(memory_format=fmt)

    def forward():
        with torch.no_grad():
            return run()

    def forward_backward():
        for x in inputs:
            x.grad = None
        run().backward(gy)

    forward_backward()
    store.result("y", y)
    for i, x in enumerate(inputs):
        store.result(f"grad_x{i}", x.grad)
    return {"forward": forward, "forward_backward": forward_backward}, {}


def batch_norm(case, store, inputs, then=lambda y: y):
    """Batch norm in training, with running statistics, and what follows; scale and offset take a gradient too."""
    norm = torch.nn.BatchNorm2d(case["shapes"][0][1])
    with torch.no_grad():
        norm.weight.copy_(store.normal("scale", tuple(norm.weight.shape)))
        norm.bias.copy_(store.normal("offset", tuple(norm.bias.shape)))

    def run():
        norm.weight.grad = norm.bias.grad = None
        return then(norm(inputs[0]))

    return run


def batch_norm_relu(case, store, inputs):
    """As the networks have it: in place."""
    return batch_norm(case, store, inputs, lambda y: F.relu(y, inplace=True))


def batch_norm_elu(case, store, inputs):
    """In place, too."""
    return batch_norm(case, store, inputs, lambda y: F.elu(y, inplace=True))


def batch_norm_skip_relu(case, store, inputs):
    """As the networks have it: sum and activation in place."""
    return batch_norm(case, store, inputs, lambda y: F.relu(y.add_(inputs[1]), inplace=True))


def conv_elu(case, store, inputs):
    """3x3 convolution over a reflected border with ELU, as Monodepth2's decoder has it; weight and bias take a gradient too."""
    channels = case["shapes"][0][1]
    conv = torch.nn.Conv2d(channels, channels, 3)
    with torch.no_grad():
        conv.weight.copy_(store.normal("weight", tuple(conv.weight.shape), (9 * channels) ** -0.5))
        conv.bias.copy_(store.normal("bias", tuple(conv.bias.shape)))

    def run():
        conv.weight.grad = conv.bias.grad = None
        return F.elu(conv(F.pad(inputs[0], (1, 1, 1, 1), mode="reflect")), inplace=True)

    return run


def plain(function):
    """An operation on the inputs without parameters."""
    return lambda case, store, inputs: lambda: function(*inputs)


OPS = {
    "batch_norm": batch_norm,
    "batch_norm_relu": batch_norm_relu,
    "batch_norm_elu": batch_norm_elu,
    "conv_elu": conv_elu,
    "batch_norm_skip_relu": batch_norm_skip_relu,
    "resize": plain(lambda x: F.interpolate(x, scale_factor=2, mode="bilinear", align_corners=False)),
    "elu": plain(F.elu),
    "relu": plain(F.relu),
    "sigmoid": plain(torch.sigmoid),
    "exp": plain(torch.exp),
    "reflect_pad": plain(lambda x: F.pad(x, (1, 1, 1, 1), mode="reflect")),
    "up2_concat": plain(lambda low, skip: torch.cat([F.interpolate(low, scale_factor=2, mode="nearest"), skip], 1)),
    "max_pool": plain(lambda x: F.max_pool2d(x, 3, 2, 1)),
}
