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
    matrix = store.input("camera", (3, 3), lambda rng: scene.camera_matrix(h, w))
    camera = photometric.Camera(matrix, h, w)
    target, *sources = scene.images(store, n, h, w)
    depth_t, depth_s = scene.depth(store, "depth_t", n, h, w), scene.depth(store, "depth_s", n, h, w)
    rotation, translation = scene.motion(store, n)
    flow = scene.flow(store, depth_t, translation)
    chosen = store.input(
        "mask", (n, 1, h, w), lambda rng: well_conditioned(rng, camera, depth_s, flow, rotation[:n], translation[:n])
    ).bool()
    leaves = {"depth_t": depth_t, "depth_s": depth_s, "rotation": rotation, "translation": translation}
    leaves = {name: leaf.requires_grad_() for name, leaf in leaves.items()}

    def terms(part):
        found = {}
        if part != "photo":
            four = geometric.losses(camera, depth_t, depth_s, flow, rotation[:n], translation[:n], chosen)
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


def well_conditioned(rng, camera, depth_s, flow, rotation, translation):
    """A mask with smooth gaps for what moves or is hidden, and without the pixels where the printed terms divide by almost zero:
    there, numbers of different programs cannot be compared in f32.
    """
    n, _, h, w = depth_s.shape
    with torch.no_grad():
        planar, axial, _ = geometric.align(camera, depth_s, flow, rotation, translation)
        along = (axial * camera.offset).sum(1, keepdim=True) / camera.radius.clamp(min=1.0)
        cosine_p = planar[:, :1].abs() / planar.norm(dim=1, keepdim=True)
        cosine_a = along.abs() / axial.norm(dim=1, keepdim=True)
        sound = (planar.abs().amin(1, keepdim=True) > 0.1) & (along.abs() > 0.1) & ((along + camera.radius).abs() > 0.1)
        sound &= (cosine_p < 0.9999) & (cosine_a < 0.9999) & (camera.radius > 1.0)
    return (scene.smooth_field(rng, n, 1, h, w, 12) > -0.8) & sound.numpy()
