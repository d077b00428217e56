"""Adam's step over some parameter tensors, as PyTorch chooses its kernels."""

import torch


def build(case, variant, store):
    """`case`: name, shapes, rate."""
    del variant
    shapes = [tuple(shape) for shape in case["shapes"]]
    weights = [torch.nn.Parameter(store.normal(f"w{i}", shape, 0.05)) for i, shape in enumerate(shapes)]
    gradients = [[store.normal(f"{kind}{i}", shape) for i, shape in enumerate(shapes)] for kind in "gh"]
    optimiser = torch.optim.Adam(weights, case["rate"])

    def step(which=0):
        for weight, gradient in zip(weights, gradients[which]):
            weight.grad = gradient
        optimiser.step()

    step(0)
    step(1)
    for i, weight in enumerate(weights):
        store.result(f"w{i}", weight)
    return {"step": step}, {}
