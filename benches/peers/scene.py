"""A synthetic scene: road-like depth, small motion, a rigid flow with some error, colours of realistic contrast."""

import numpy as np
import torch
import torch.nn.functional as F


def rotations(vectors):
    """Rodrigues' formula for rotation vectors [n, 3], float64."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    axis = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    k = np.zeros((len(vectors), 3, 3))
    k[:, 0, 1], k[:, 0, 2] = -axis[:, 2], axis[:, 1]
    k[:, 1, 0], k[:, 1, 2] = axis[:, 2], -axis[:, 0]
    k[:, 2, 0], k[:, 2, 1] = -axis[:, 1], axis[:, 0]
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * (k @ k)


def smooth_field(rng, n, c, h, w, cells=8):
    """Normally distributed numbers on a coarse grid, interpolated."""
    small = rng.standard_normal((n, c, cells, 2 * cells)).astype(np.float32)
    return F.interpolate(torch.from_numpy(small), size=(h, w), mode="bicubic", align_corners=True).numpy()


def camera_matrix(h, w):
    """K of a camera with the principal point in the middle, pixels."""
    return np.array([[0.58 * w, 0, 0.5 * w - 0.5], [0, 1.92 * h, 0.5 * h - 0.5], [0, 0, 1]])


def image(rng, n, h, w):
    """Colours in [0, 1], [n, 3, h, w]."""
    return np.clip(0.5 + 0.2 * smooth_field(rng, n, 3, h, w, 24) + 0.05 * rng.standard_normal((n, 3, h, w)), 0, 1)


def images(store, n, h, w):
    """Target, previous and next image, each [n, 3, h, w]."""
    return [store.input(name, (n, 3, h, w), lambda rng: image(rng, n, h, w)) for name in ("target", "previous", "next")]


def depth(store, name, n, h, w):
    """Depth of a view, [n, 1, h, w]."""
    return store.input(name, (n, 1, h, w), lambda rng: 8.0 * np.exp(0.5 * smooth_field(rng, n, 1, h, w)))


def motion(store, n):
    """Rotation [2 n, 3, 3] and translation [2 n, 3] from the target to both sources, those of the previous one first."""
    # Sideways enough for the planar loss in pixels to count.
    towards = np.repeat([[0.25, 0.08, 0.5], [-0.22, -0.07, -0.45]], n, axis=0)
    rotation = store.input("rotation", (2 * n, 3, 3), lambda rng: rotations(0.01 * rng.standard_normal((2 * n, 3)) + 1e-3))
    translation = store.input("translation", (2 * n, 3), lambda rng: towards + 0.02 * rng.standard_normal((2 * n, 3)))
    return rotation, translation


def flow(store, name, depth_t, translation):
    """A flow of the first source [n, 2, h, w], pixels: the rigid flow of a slightly different motion, with smooth errors."""
    n, _, h, w = depth_t.shape
    k = camera_matrix(h, w)

    def make(rng):
        v, u = np.meshgrid(np.arange(h), np.arange(w), indexing="ij")
        pixels = np.stack([u, v, np.ones_like(u)]).reshape(3, -1).astype(np.float64)
        points = depth_t.numpy().reshape(n, 1, -1) * (np.linalg.inv(k) @ pixels)[None]
        moved = rotations(0.01 * rng.standard_normal((n, 3)) + 1e-3) @ points
        seen = k @ (moved + 1.05 * translation[:n].double().numpy()[:, :, None])
        found = (seen[:, :2] / seen[:, 2:] - pixels[None, :2]).reshape(n, 2, h, w)
        return found + 0.3 * smooth_field(rng, n, 2, h, w, 16)

    return store.input(name, (n, 2, h, w), make)
