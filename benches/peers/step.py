#!/usr/bin/env python3
"""One training step: depth and pose network with minimum reprojection, auto-mask and smoothness on every scale, as Monodepth2 has
it; a flow network with its own photometric loss beside them; Adam.

As a program it takes a few steps of one case and prints its peak memory:

    step.py CASE FOLDER THREADS
"""

import json
import sys

import torch
import torch.nn.functional as F

import photometric
import scene
from networks import MAKERS, share_parameters
from store import Store, memory_format

MIN_DEPTH, MAX_DEPTH = 0.1, 100.0
SMOOTHNESS = 1e-3
# Of the flow: weight of its smoothness, sharpness of the edges, share of each flow's weight in the next one's.
FLOW_SMOOTHNESS, FLOW_EDGE, GAMMA = 0.02, 10.0, 0.8
# Steps whose losses are compared.
COMPARED = 3


def rotation_matrices(vectors):
    """Rotation vectors [n, 3] to matrices."""
    angle = vectors.norm(dim=1).clamp(min=1e-7)[:, None, None]
    axis = vectors / angle[:, :, 0]
    zero = torch.zeros_like(axis[:, 0])
    x, y, z = axis.unbind(1)
    k = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).view(-1, 3, 3)
    return torch.eye(3) + torch.sin(angle) * k + (1 - torch.cos(angle)) * (k @ k)


def source_from_target(motions, target, previous, following):
    """Rotations and translations from the target to both sources; the network sees the earlier image first."""
    n = len(target)
    rotation, translation = motions(torch.cat([previous, target]), torch.cat([target, following]))
    rotation = rotation_matrices(rotation)
    back = rotation[:n].transpose(1, 2)
    moved = -(back @ translation[:n, :, None])[:, :, 0]
    return torch.cat([back, rotation[n:]]), torch.cat([moved, translation[n:]])


def scene_loss(disparities, motions, camera, images):
    """The loss of target, previous and next image: a mean over the scales."""
    target, *sources = images
    disparities = disparities(target, None)
    rotation, translation = source_from_target(motions, target, *sources)
    identities = photometric.identity_errors(target, sources)
    total = 0.0
    for scale, disparity in enumerate(disparities):
        small = target
        full = disparity
        if scale > 0:
            full = F.interpolate(disparity, size=target.shape[2:], mode="bilinear", align_corners=False)
            small = F.interpolate(target, size=disparity.shape[2:], mode="bilinear", align_corners=False)
        depth = 1.0 / (1.0 / MAX_DEPTH + (1.0 / MIN_DEPTH - 1.0 / MAX_DEPTH) * full)
        found = photometric.minimum_reprojection(camera, depth, rotation, translation, target, sources, identities)
        total = total + found + SMOOTHNESS / (1 << scale) * photometric.smoothness(disparity, small)
    return total / len(disparities)


def second_differences(flow, image):
    """Mean size of the second differences of a flow, excused where the image has steps, ARFlow's form."""
    total = 0.0
    for axis in (2, 3):
        bent = flow.diff(dim=axis).diff(dim=axis).abs()
        step = image.diff(dim=axis).abs().mean(1, keepdim=True)
        excused = torch.exp(-FLOW_EDGE * step.narrow(axis, 1, step.shape[axis] - 1))
        total = total + (bent * excused).mean() / 2
    return total


def flow_loss(flows, camera, target, source):
    """Successive flows, later ones weighted more: how the source looks when it is read where they lead, and how smooth they are."""
    total = 0.0
    for i, flow in enumerate(flows):
        ends = camera.pixels + flow
        size = ends.new_tensor([camera.w - 1, camera.h - 1]).reshape(1, 2, 1, 1)
        inside = ((ends >= 0) & (ends <= size)).all(1, keepdim=True)
        error = photometric.error(camera.sample(source, ends), target) * inside
        found = (error.sum((1, 2, 3)) / inside.sum((1, 2, 3))).mean()
        total = total + GAMMA ** (len(flows) - 1 - i) * (found + FLOW_SMOOTHNESS * second_differences(flow, target))
    return total


def build(case, variant, store):
    """`case`: name, batch, height, img_width, and the sizes of the networks `depth`, `pose` and, or null, `flow`."""
    n, h, w = case["batch"], case["height"], case["img_width"]
    fmt = memory_format(variant["layout"])
    torch.manual_seed(1)
    modules, runs = {}, {}
    for role in MAKERS:
        if case[role] is not None:
            modules[role], runs[role] = MAKERS[role](case[role])
    files = {file: module for found in modules.values() for file, module in found.items()}
    share_parameters(store, files)
    model = torch.nn.ModuleDict(files).train().to(memory_format=fmt)
    optimiser = torch.optim.Adam(model.parameters(), 1e-4)
    camera = photometric.Camera(store.input("camera", (3, 3), lambda rng: scene.camera_matrix(h, w)), h, w)
    images = [image.contiguous(memory_format=fmt) for image in scene.images(store, n, h, w)]

    def loss():
        total = scene_loss(runs["depth"], runs["pose"], camera, images)
        if "flow" in runs:
            total = total + flow_loss(runs["flow"](images[0], images[2]), camera, images[0], images[2])
        return total

    def step():
        optimiser.zero_grad(set_to_none=True)
        value = loss()
        value.backward()
        optimiser.step()
        return value

    def norm(modules):
        squares = [p.grad.double().square().sum() for m in modules for p in m.parameters() if p.grad is not None]
        return sum(squares).sqrt().item()

    values = {}
    for i in range(COMPARED):
        values[f"loss_{i}"] = step().item()
        if i == 0:
            values.update((f"{role}_gradient", norm(found.values())) for role, found in modules.items())
    return {"step": step}, values


def memory(key):
    """A number of /proc/self/status, KiB."""
    with open("/proc/self/status", encoding="ascii") as status:
        return int(next(line.split()[1] for line in status if line.startswith(key)))


def main():
    """Takes some steps and prints the resident memory after the imports and at its peak."""
    case, folder, threads = json.loads(sys.argv[1]), sys.argv[2], int(sys.argv[3])
    start = memory("VmRSS")
    torch.set_num_threads(threads)
    timed, _ = build(case, {"layout": "nchw"}, Store(folder, case["name"], "memory"))
    timed["step"]()
    print(json.dumps({"start_kib": start, "peak_kib": memory("VmHWM")}))


if __name__ == "__main__":
    main()
