"""Writes the files of this folder with PyTorch: python make_fixtures.py

Every value is i / 8 - 1 for the flat index i of its storage, so that it is exact in half precision and the tests can state it.
"""

import argparse
import os
import pickle
from collections import OrderedDict

import torch
from torch import nn


def ramp(*shape, dtype=torch.float32):
    count = 1
    for side in shape:
        count *= side
    return (torch.arange(count, dtype=torch.float64) / 8 - 1).reshape(shape).to(dtype)


def state(prefix=""):
    return {
        prefix + "conv.weight": ramp(2, 3, 1, 2),
        prefix + "bn.running_mean": ramp(4),
        prefix + "bn.num_batches_tracked": torch.tensor(7),
        prefix + "scale": torch.tensor(2.5),
    }


class Net(nn.Module):
    """A convolution and a norm, so that the state has metadata of modules."""

    def __init__(self):
        super().__init__()
        self.conv = nn.Conv2d(1, 2, 3)
        self.bn = nn.BatchNorm2d(2)

    def forward(self, x):
        return self.bn(self.conv(x))


def net():
    module = Net()
    with torch.no_grad():
        for value in list(module.parameters()) + [module.bn.running_mean, module.bn.running_var]:
            value.copy_(ramp(*value.shape))
    return module


class Malicious:
    def __reduce__(self):
        return (os.system, ("touch executed",))


def trained():
    """A checkpoint of a training: the state under a key, beside what such programs add."""
    module = net()
    optimiser = torch.optim.Adam(module.parameters(), lr=1e-3)
    module(torch.ones(1, 1, 5, 5)).square().mean().backward()
    optimiser.step()
    # The step moved the values: back to the ones that the tests know.
    return {
        "epoch": 3,
        "best": 0.25,
        "note": "a run",
        "state_dict": net().state_dict(),
        "optimizer": optimiser.state_dict(),
        "args": argparse.Namespace(lr=1e-3, layers=[1, 2], name="x"),
    }


def views():
    base = ramp(24)
    return {
        "transposed": base.reshape(4, 6).t(),
        "channels_last": base.reshape(1, 2, 3, 4).permute(0, 2, 3, 1),
        "offset": base[5:9],
        "stepped": base[1::5],
        "expanded": base[2:4].reshape(2, 1).expand(2, 3),
        "whole": base,
    }


def types():
    kinds = ["float64", "float32", "float16", "bfloat16", "int64", "int32", "int16", "int8"]
    state = {kind: (ramp(5, dtype=torch.float64) * 8).to(getattr(torch, kind)) for kind in kinds}
    state["uint8"] = torch.arange(5, dtype=torch.uint8) + 250
    state["bool"] = torch.tensor([True, False, True])
    state["float16_special"] = torch.tensor([6e-8, -0.0, 65504.0, 3.1415927], dtype=torch.float16)
    return state


def lite_mono_decoder():
    """The decoder of the nano Lite-Mono in half precision, as saved from several devices; values repeat after 16."""
    sides = {f"{n}.conv.conv": side for n, side in enumerate([(16, 32), (16, 40), (12, 16), (12, 28), (8, 12), (8, 8)])}
    sides |= {f"{6 + scale}.conv": (1, width) for scale, width in enumerate([8, 12, 16])}
    state = OrderedDict()
    for name, (outputs, inputs) in sides.items():
        for kind, shape in ("weight", (outputs, inputs, 3, 3)), ("bias", (outputs,)):
            values = torch.arange(torch.Size(shape).numel()) % 16 / 8 - 1
            state[f"module.decoder.{name}.{kind}"] = values.reshape(shape).half()
    return state


def main():
    torch.save(state(), "plain.pth")
    torch.save(net().state_dict(), "ordered.pth")
    torch.save(state("_orig_mod.module.module."), "wrapped.pth")
    torch.save(trained(), "trained.pth")
    torch.save(state() | {"height": 192, "width": 640, "use_stereo": False}, "with_sizes.pth")
    torch.save(types(), "types.pth")
    torch.save(views(), "views.pth")
    torch.save(lite_mono_decoder(), "nano_lite_mono_depth.pth")
    torch.save({"weight": nn.Parameter(ramp(3))}, "parameter.pth")
    torch.save(OrderedDict(state()), "protocol_4.pth", pickle_protocol=4)
    torch.save(state(), "legacy.pth", _use_new_zipfile_serialization=False)
    torch.save(net(), "module.pth")
    torch.save(state() | {"extra": Malicious()}, "malicious.pth")
    torch.save([ramp(2), ramp(3)], "list.pth")
    torch.save({"complex": torch.zeros(2, dtype=torch.complex64)}, "complex.pth")
    torch.jit.script(nn.ReLU()).save("script.pt")
    with open("bare.pkl", "wb") as file:
        pickle.dump({"a": 1}, file)


if __name__ == "__main__":
    main()
