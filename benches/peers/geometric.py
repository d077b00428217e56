"""The four geometric losses in their printed form, with the alignment as printed.

Same definitions, masks and means as `dimode_geometry::losses` with `LossOptions::literal()`: every loss is a mean over the usable
pixels of an image, then over the images. Divisions have no guard but that by exactly zero, as printed.
"""

import torch

from photometric import Z_MIN


def mean(x, mask):
    """Mean over the pixels of a mask, one number for each image; other pixels pass neither value nor gradient."""
    return torch.where(mask, x, torch.zeros_like(x)).sum((1, 2, 3)) / mask.sum((1, 2, 3)).clamp(min=1)


def keep(x, mask, filler):
    """`x` inside the mask, a constant outside."""
    return torch.where(mask, x, torch.full_like(x, filler))


def arccos(cosine):
    """The angle of a cosine; no slope where rounding says exactly +-1."""
    cosine = cosine.clamp(-1, 1)
    return torch.acos(torch.where(cosine.abs() < 1, cosine, cosine.detach()))


def align(camera, depth_s, flow, rotation, translation):
    """Depth of the source at the flow's ends, planar and axial flow, and where all are usable."""
    n, _, h, w = depth_s.shape
    ends = camera.pixels + flow
    inside = (ends[:, :1] >= 0) & (ends[:, :1] <= w - 1) & (ends[:, 1:] >= 0) & (ends[:, 1:] <= h - 1)
    depth = camera.sample(depth_s, ends)
    rays = camera.inverse @ torch.cat([ends, torch.ones_like(depth)], 1).reshape(n, 3, -1)
    x, y, z = (rotation.transpose(1, 2) @ (depth.reshape(n, 1, -1) * rays)).reshape(n, 3, h, w).split(1, 1)
    tx, ty, tz = translation.reshape(n, 3, 1, 1).split(1, 1)

    def project(x, y, z):
        return torch.cat([x / z, y / z], 1) * camera.focal - camera.offset

    z_plane = z - tz
    usable = inside & (depth > Z_MIN) & (z_plane > Z_MIN) & (z > Z_MIN)
    planar = project(x, y, keep(z_plane, z_plane > Z_MIN, 1.0))
    axial = project(x - tx, y - ty, keep(z, z > Z_MIN, 1.0))
    return planar, axial, usable


def ratio(depth, product, recovered, divisible, mask, t):
    """Error of the ratio at every pixel, and of the translation recovered from all: `A + C`."""
    z = keep(depth, divisible, 1.0)
    pixel = mean((keep(product * t[:, None, None, None], divisible, 1.0) - z).abs() / z, divisible)
    return pixel + ((mean(recovered, mask) - t) / t).abs()


def losses(camera, depth_t, depth_s, flow, rotation, translation, mask):
    """L_pla, L_axi, L_tan, L_rad."""
    planar, axial, usable = align(camera, depth_s, flow, rotation, translation)
    base = mask & usable

    long = base & (planar.square().sum(1, keepdim=True) > 0)
    pu, pv = (keep(planar[:, i : i + 1], long, 1.0) for i in (0, 1))
    angle = arccos(pu / (pu * pu + pv * pv).sqrt())
    l_pla = mean((angle - mean(angle, long)[:, None, None, None]).square(), long)

    long = base & (axial.square().sum(1, keepdim=True) > 0) & (camera.radius > 0)
    au, av = (keep(axial[:, i : i + 1], long, 1.0) for i in (0, 1))
    along = au * camera.offset[:, :1] + av * camera.offset[:, 1:]
    cosine = along / ((au * au + av * av).sqrt() * camera.radius.clamp(min=1e-12))
    l_axi = mean(arccos(keep(cosine, long, 0.5)), long)

    base = base & (depth_t > Z_MIN)
    l_tan = 0.0
    for k in (0, 1):
        component, focal = planar[:, k : k + 1], camera.focal[:, k : k + 1]
        divisible = base & (component != 0)
        recovered = keep(depth_t * component / focal, base, 0.0)
        l_tan = l_tan + ratio(depth_t, focal / keep(component, divisible, 1.0), recovered, divisible, base, translation[:, k])

    along = (axial * camera.offset).sum(1, keepdim=True)
    square = camera.offset.square().sum(1, keepdim=True)
    divisible = base & (square > 0) & (along != 0)
    divisor = keep(along, divisible, 1.0)
    mask = base & (square > 0) & (along + square != 0)
    recovered = -keep(depth_t * along, mask, 0.0) / keep(along + square, mask, 1.0)
    l_rad = ratio(depth_t, -(divisor + square) / divisor, recovered, divisible, mask, translation[:, 2])
    return l_pla.mean(), l_axi.mean(), l_tan.mean(), l_rad.mean()
