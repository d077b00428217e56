"""The loss core: forward and backward of the geometric losses, of the photometric part, and of both.

Gradients go to the depth of the target and of one source, and to rotation and translation of both sources.
"""

import torch

import geometric
import photometric
import scene

PARTS = {"geom": ("pla", "axi", "tan", "rad"), "photo": ("photo", "smooth")}
PARTS["all"] = PARTS["geom"] + PARTS["photo"]
WEIGHTS = {"pla": 0.05, "axi": 0.05, "tan": 0.1, "rad": 0.1, "photo": 1.0, "smooth": 1e-3}


def build(case, variant, store):
    """`case`: name, batch, height, width. `variant`: mode (eager or compile)."""
    n, h, w = case["batch"], case["height"], case["width"]
    target, *sources = scene.images(store, n, h, w)
    pair = geometric.Pair(store, n, h, w)
    camera, depth_t, depth_s, rotation, translation = pair.camera, pair.depth_t, pair.depth_s, pair.rotation, pair.translation
    leaves = {"depth_t": depth_t, "depth_s": depth_s, "rotation": rotation, "translation": translation}
    leaves = {name: leaf.requires_grad_() for name, leaf in leaves.items()}

    def terms(part):
        found = {}
        if part != "photo":
            four = geometric.losses(camera, depth_t, depth_s, pair.flow, rotation[:n], translation[:n], pair.mask)
            found.update(zip(PARTS["geom"], four))
        if part != "geom":
            identities = photometric.identity_errors(target, sources)
            found["photo"] = photometric.minimum_reprojection(
                camera, depth_t, rotation, translation, target, sources, identities
            )
            found["smooth"] = photometric.smoothness(1.0 / depth_t, target)
        return found

    def total(part):
        return sum(WEIGHTS[name] * value for name, value in terms(part).items())

    def forward_backward(total):
        for leaf in leaves.values():
            leaf.grad = None
        total().backward()

    compiled = variant["mode"] == "compile"
    timed = {}
    for part in variant.get("parts", PARTS):
        function = lambda part=part: total(part)
        if compiled:
            torch._dynamo.reset()
            function = torch.compile(function, dynamic=False)
        timed[part] = lambda function=function: forward_backward(function)

    # Each term's own gradient, eagerly: what is compiled computes the same.
    values = {}
    for name in PARTS["all"]:
        part = "geom" if name in PARTS["geom"] else "photo"
        for leaf in leaves.values():
            leaf.grad = None
        value = terms(part)[name]
        value.backward()
        values[name] = value.item()
        for leaf_name, leaf in leaves.items():
            store.result(f"{name}_grad_{leaf_name}", gradient(leaf))
    for part, run in timed.items():
        run()
        for leaf_name, leaf in leaves.items():
            store.result(f"{part}_grad_{leaf_name}", gradient(leaf))
    return timed, values


def gradient(leaf):
    """Zeros where no path leads to the leaf."""
    return torch.zeros_like(leaf) if leaf.grad is None else leaf.grad
