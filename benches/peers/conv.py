"""Convolutions: forward, backward to the input, backward to weight and bias."""

import torch
import torch.nn.functional as F

from store import memory_format


def build(case, variant, store):
    """`case`: name, batch, inputs, outputs, height, width, kernel, stride, padding, dilation, groups."""
    names = ("batch", "inputs", "outputs", "height", "width", "kernel", "stride", "padding", "dilation", "groups")
    n, ci, co, h, w, k, s, p, d, g = (case[name] for name in names)
    fmt = memory_format(variant["layout"])
    x = store.normal("x", (n, ci, h, w)).contiguous(memory_format=fmt)
    # Outputs of the size of the inputs, as in a trained network.
    weight = store.normal("weight", (co, ci // g, k, k), (ci // g * k * k) ** -0.5).contiguous(memory_format=fmt)
    bias = store.normal("bias", (co,))

    def forward():
        with torch.no_grad():
            return F.conv2d(x, weight, bias, s, p, d, g)

    y = forward()
    gy = store.normal("gy", tuple(y.shape)).contiguous(memory_format=fmt)

    def backward(wanted):
        return torch.ops.aten.convolution_backward(gy, x, weight, [co], [s, s], [p, p], [d, d], False, [0, 0], g, wanted)

    grad_x, grad_weight, grad_bias = backward([True, True, True])
    for name, tensor in (("y", y), ("grad_x", grad_x), ("grad_weight", grad_weight), ("grad_bias", grad_bias)):
        store.result(name, tensor)
    leaves = [tensor.detach().clone(memory_format=torch.preserve_format).requires_grad_() for tensor in (x, weight, bias)]

    def forward_backward():
        for leaf in leaves:
            leaf.grad = None
        F.conv2d(*leaves, s, p, d, g).backward(gy)

    timed = {
        "forward": forward,
        "backward_data": lambda: backward([True, False, False]),
        "backward_weight": lambda: backward([False, True, True]),
        "backward_both": lambda: backward([True, True, True]),
        "forward_backward": forward_backward,
    }
    return timed, {}
