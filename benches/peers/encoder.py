"""ResNet-18 encoder in training: forward, and forward with backward from its last feature map."""

import torch

from networks import Encoder, resnet18_widths, share_parameters
from store import memory_format


def build(case, variant, store):
    """`case`: name, width, batch, height, img_width."""
    n, h, w = case["batch"], case["height"], case["img_width"]
    fmt = memory_format(variant["layout"])
    torch.manual_seed(1)
    net = Encoder(1, resnet18_widths(case["width"])).train()
    share_parameters(store, {"encoder": net})
    net = net.to(memory_format=fmt)
    x = store.input("x", (n, 3, h, w), lambda rng: rng.random((n, 3, h, w))).contiguous(memory_format=fmt)
    y = net(x)[4]
    gy = store.normal("gy", tuple(y.shape)).contiguous(memory_format=fmt)

    def forward():
        with torch.no_grad():
            return net(x)

    def forward_backward():
        net.zero_grad(set_to_none=True)
        net(x)[4].backward(gy)

    forward_backward()
    store.result("y", y)
    for name, parameter in net.named_parameters():
        store.result(f"grad_encoder:{name}", parameter.grad)
    return {"forward": forward, "forward_backward": forward_backward}, {}
