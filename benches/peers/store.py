"""Numbers shared with the Rust side: raw little-endian f32 files in one folder for each case."""

import os
import zlib

import numpy as np
import torch


class Store:
    """A folder `inputs` that both sides read, and a folder of this variant's results.

    The first variant that asks for an input makes it and writes it; all others, and the Rust side, read the same file.
    """

    def __init__(self, root, case, variant):
        self.inputs = os.path.join(root, case, "inputs")
        self.results = os.path.join(root, case, variant)
        self.seed = zlib.crc32(case.encode())
        os.makedirs(self.inputs, exist_ok=True)
        os.makedirs(self.results, exist_ok=True)

    def generator(self, name):
        """Random numbers that depend on the case and the name only."""
        return np.random.default_rng([self.seed, zlib.crc32(name.encode())])

    def input(self, name, shape, make):
        """The input `name` of the given shape; `make(generator)` is called when it is not there yet."""
        path = os.path.join(self.inputs, name + ".bin")
        if not os.path.exists(path):
            write(path, np.broadcast_to(make(self.generator(name)), shape))
        return torch.from_numpy(np.fromfile(path, dtype="<f4").reshape(shape).copy())

    def normal(self, name, shape, scale=1.0):
        """An input of normally distributed numbers."""
        return self.input(name, shape, lambda rng: scale * rng.standard_normal(shape))

    def result(self, name, tensor):
        """Writes a result, contiguous in the order n, c, h, w."""
        write(os.path.join(self.results, name + ".bin"), tensor.detach().contiguous().numpy())


def write(path, array):
    """Writes an array as raw f32, whole or not at all."""
    np.ascontiguousarray(array, dtype="<f4").tofile(path + ".part")
    os.replace(path + ".part", path)


def memory_format(layout):
    """The memory format that a layout's name stands for."""
    return torch.channels_last if layout == "channels_last" else torch.contiguous_format
