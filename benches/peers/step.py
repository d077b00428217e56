#!/usr/bin/env python3
"""One training step as Monodepth2 has it: networks, minimum reprojection with auto-mask and smoothness on four scales, Adam.

As a program it takes a few steps of one size and prints its peak memory:

    step.py '{"name": "step", "width": 64, "decoder": [16, 32, 64, 128, 256], "pose_width": 256, "batch": 1, "height": 192,
              "img_width": 640}' FOLDER THREADS
"""

import json
import sys

import torch
import torch.nn.functional as F

import photometric
import scene
from networks import Monodepth, share_parameters
from store import Store, memory_format

MIN_DEPTH, MAX_DEPTH = 0.1, 100.0
SMOOTHNESS = 1e-3
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


def source_from_target(model, target, previous, following):
    """Rotations and translations from the target to both sources; the network sees the earlier image first."""
    n = len(target)
    said = model.motions(torch.cat([previous, target]), torch.cat([target, following]))
    rotation, translation = rotation_matrices(said[:, :3]), said[:, 3:]
    back = rotation[:n].transpose(1, 2)
    moved = -(back @ translation[:n, :, None])[:, :, 0]
    return torch.cat([back, rotation[n:]]), torch.cat([moved, translation[n:]])


def loss(model, camera, images):
    """The loss of target, previous and next image: a mean over four scales."""
    target, *sources = images
    disparities = model.disparities(target)
    rotation, translation = source_from_target(model, target, *sources)
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


def build(case, variant, store):
    """`case`: name, width, decoder, pose_width, batch, height, img_width."""
    n, h, w = case["batch"], case["height"], case["img_width"]
    fmt = memory_format(variant["layout"])
    torch.manual_seed(1)
    model = Monodepth(case["width"], case["decoder"], case["pose_width"]).train()
    files = {"encoder": model.encoder, "depth": model.depth, "pose_encoder": model.pose_encoder, "pose": model.pose}
    share_parameters(store, files)
    model = model.to(memory_format=fmt)
    optimiser = torch.optim.Adam(model.parameters(), 1e-4)
    camera = photometric.Camera(store.input("camera", (3, 3), lambda rng: scene.camera_matrix(h, w)), h, w)
    images = [image.contiguous(memory_format=fmt) for image in scene.images(store, n, h, w)]

    def step():
        optimiser.zero_grad(set_to_none=True)
        value = loss(model, camera, images)
        value.backward()
        optimiser.step()
        return value

    def norm(*modules):
        squares = [p.grad.double().square().sum() for module in modules for p in module.parameters() if p.grad is not None]
        return sum(squares).sqrt().item()

    values = {}
    for i in range(COMPARED):
        values[f"loss_{i}"] = step().item()
        if i == 0:
            values["depth_gradient"] = norm(model.encoder, model.depth)
            values["pose_gradient"] = norm(model.pose_encoder, model.pose)
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
