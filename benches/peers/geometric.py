"""The four geometric losses in their printed form, with the alignment as printed, and in the form of training, in pixels.

Same definitions, masks and means as `dimode_geometry::losses` with `LossOptions::literal()` and `LossOptions::default()`:
every loss is a mean over the usable pixels of an image, then over the images. Divisions of the printed form have no guard
but that by exactly zero, as printed.
"""

import torch
import torch.nn.functional as F

import photometric
import scene
from photometric import Z_MIN

# The planar loss in pixels: shortest predicted tangential flow, and smallest tangential share of the translation.
SHORTEST, SHARE = 0.5, 0.3
# Errors of the flow that count for nothing: pixels, and share of the flow's length.
NOISE, NOISE_SHARE = 0.5, 0.15
# Nearer to the principal point radial directions mean nothing, pixels.
NEAREST = 1.0
FOUR = (True, True, True, True)


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


def align(camera, depth_s, flow, rotation, a, wanted=FOUR):
    """Planar and axial flow after the alignment that removes the translation `a`, and where both are usable.

    A flow that none of the wanted losses reads is not computed.
    """
    n, _, h, w = depth_s.shape
    ends = camera.pixels + flow
    inside = (ends[:, :1] >= 0) & (ends[:, :1] <= w - 1) & (ends[:, 1:] >= 0) & (ends[:, 1:] <= h - 1)
    depth = camera.sample(depth_s, ends)
    rays = camera.inverse @ torch.cat([ends, torch.ones_like(depth)], 1).reshape(n, 3, -1)
    x, y, z = (rotation.transpose(1, 2) @ (depth.reshape(n, 1, -1) * rays)).reshape(n, 3, h, w).split(1, 1)
    ax, ay, az = a.reshape(n, 3, 1, 1).split(1, 1)

    def project(x, y, z):
        return torch.cat([x / z, y / z], 1) * camera.focal - camera.offset

    z_plane = z - az
    usable = inside & (depth > Z_MIN) & (z_plane > Z_MIN) & (z > Z_MIN)
    planar = project(x, y, keep(z_plane, z_plane > Z_MIN, 1.0)) if wanted[0] or wanted[2] else None
    axial = project(x - ax, y - ay, keep(z, z > Z_MIN, 1.0)) if wanted[1] or wanted[3] else None
    return planar, axial, usable


def ratio(depth, product, recovered, divisible, mask, t):
    """Error of the ratio at every pixel, and of the translation recovered from all: `A + C`."""
    z = keep(depth, divisible, 1.0)
    pixel = mean((keep(product * t[:, None, None, None], divisible, 1.0) - z).abs() / z, divisible)
    return pixel + ((mean(recovered, mask) - t) / t).abs()


def printed_planar(planar, base):
    """Variance of the angles of the planar flow."""
    long = base & (planar.square().sum(1, keepdim=True) > 0)
    pu, pv = (keep(planar[:, i : i + 1], long, 1.0) for i in (0, 1))
    angle = arccos(pu / (pu * pu + pv * pv).sqrt())
    return mean((angle - mean(angle, long)[:, None, None, None]).square(), long)


def printed_axial(camera, axial, base):
    """Mean angle between the axial flow and the radius."""
    long = base & (axial.square().sum(1, keepdim=True) > 0) & (camera.radius > 0)
    au, av = (keep(axial[:, i : i + 1], long, 1.0) for i in (0, 1))
    along = au * camera.offset[:, :1] + av * camera.offset[:, 1:]
    cosine = along / ((au * au + av * av).sqrt() * camera.radius.clamp(min=1e-12))
    return mean(arccos(keep(cosine, long, 0.5)), long)


def printed_tangential(camera, planar, depth_t, translation, base):
    """Ratios along both axes."""
    base = base & (depth_t > Z_MIN)
    total = 0.0
    for k in (0, 1):
        component, focal = planar[:, k : k + 1], camera.focal[:, k : k + 1]
        divisible = base & (component != 0)
        recovered = keep(depth_t * component / focal, base, 0.0)
        total = total + ratio(depth_t, focal / keep(component, divisible, 1.0), recovered, divisible, base, translation[:, k])
    return total


def printed_radial(camera, axial, depth_t, translation, base):
    """The ratio along the optical axis."""
    base = base & (depth_t > Z_MIN)
    along = (axial * camera.offset).sum(1, keepdim=True)
    square = camera.offset.square().sum(1, keepdim=True)
    divisible = base & (square > 0) & (along != 0)
    divisor = keep(along, divisible, 1.0)
    mask = base & (square > 0) & (along + square != 0)
    recovered = -keep(depth_t * along, mask, 0.0) / keep(along + square, mask, 1.0)
    return ratio(depth_t, -(divisor + square) / divisor, recovered, divisible, mask, translation[:, 2])


def pixel_planar(camera, planar, depth_t, a, base, noise):
    """Distance of the planar flow from the line of the predicted one."""
    predicted = camera.focal * a[:, :2, None, None]
    size = predicted.norm(dim=1, keepdim=True)
    sideways = a[:, :2].norm(dim=1) >= SHARE * a.norm(dim=1)
    direction = predicted / size.clamp(min=1e-12)
    distance = planar[:, :1] * direction[:, 1:] - planar[:, 1:] * direction[:, :1]
    return mean(F.relu(distance.abs() - noise), base & (size > SHORTEST * depth_t) & sideways[:, None, None, None])


def pixel_axial(camera, axial, base, noise):
    """Distance of the axial flow from the radial line."""
    across = camera.offset[:, :1] * axial[:, 1:] - camera.offset[:, 1:] * axial[:, :1]
    distance = across / camera.radius.clamp(min=NEAREST)
    return mean(F.relu(distance.abs() - noise), base & (camera.radius > NEAREST))


def pixel_tangential(camera, planar, depth_t, a, base, noise):
    """Planar flow against what depth and tangential translation say."""
    mask = base & (depth_t > Z_MIN)
    residual = planar - camera.focal * a[:, :2, None, None] / keep(depth_t, mask, 1.0)
    return mean(F.relu(residual.norm(dim=1, keepdim=True) - noise), mask)


def pixel_radial(camera, axial, depth_t, a, base, noise):
    """Axial flow along the radius against what depth and radial translation say."""
    az = a[:, 2:, None, None]
    mask = base & (depth_t > Z_MIN) & (camera.radius >= NEAREST) & (depth_t + az > Z_MIN)
    radius = camera.radius.clamp(min=NEAREST)
    along = (axial * camera.offset).sum(1, keepdim=True) / radius
    residual = along + radius * az / keep(depth_t + az, mask, 1.0)
    return mean(F.relu(residual.abs() - noise), mask)


def losses(camera, depth_t, depth_s, flow, rotation, translation, mask, form="printed", wanted=FOUR):
    """Those of L_pla, L_axi, L_tan and L_rad that are wanted."""
    if form == "printed":
        planar, axial, usable = align(camera, depth_s, flow, rotation, translation, wanted)
        base = mask & usable
        found = (
            lambda: printed_planar(planar, base),
            lambda: printed_axial(camera, axial, base),
            lambda: printed_tangential(camera, planar, depth_t, translation, base),
            lambda: printed_radial(camera, axial, depth_t, translation, base),
        )
    else:
        # The translation in the target's frame; the source depth teaches nobody here.
        a = (rotation.transpose(1, 2) @ translation[:, :, None])[:, :, 0]
        planar, axial, usable = align(camera, depth_s.detach(), flow, rotation, a, wanted)
        base = mask & usable
        noise = NOISE + NOISE_SHARE * flow.norm(dim=1, keepdim=True)
        found = (
            lambda: pixel_planar(camera, planar, depth_t, a, base, noise),
            lambda: pixel_axial(camera, axial, base, noise),
            lambda: pixel_tangential(camera, planar, depth_t, a, base, noise),
            lambda: pixel_radial(camera, axial, depth_t, a, base, noise),
        )
    return [loss().mean() for loss, chosen in zip(found, wanted) if chosen]


def well_conditioned(rng, camera, depth_s, flow, rotation, translation):
    """A mask with smooth gaps for what moves or is hidden, and without the pixels where the printed terms divide by almost zero:
    there, numbers of different programs cannot be compared in f32.
    """
    n, _, h, w = depth_s.shape
    with torch.no_grad():
        planar, axial, _ = align(camera, depth_s, flow, rotation, translation)
        along = (axial * camera.offset).sum(1, keepdim=True) / camera.radius.clamp(min=1.0)
        cosine_p = planar[:, :1].abs() / planar.norm(dim=1, keepdim=True)
        cosine_a = along.abs() / axial.norm(dim=1, keepdim=True)
        sound = (planar.abs().amin(1, keepdim=True) > 0.1) & (along.abs() > 0.1) & ((along + camera.radius).abs() > 0.1)
        sound &= (cosine_p < 0.9999) & (cosine_a < 0.9999) & (camera.radius > 1.0)
    return (scene.smooth_field(rng, n, 1, h, w, 12) > -0.8) & sound.numpy()


class Pair:
    """A batch of the scene with one source: camera, both depths, flow, motion to both sources, and the mask of usable pixels."""

    def __init__(self, store, n, h, w):
        self.camera = photometric.Camera(store.input("camera", (3, 3), lambda rng: scene.camera_matrix(h, w)), h, w)
        self.depth_t, self.depth_s = scene.depth(store, "depth_t", n, h, w), scene.depth(store, "depth_s", n, h, w)
        self.rotation, self.translation = scene.motion(store, n)
        self.flow = scene.flow(store, "flow", self.depth_t, self.translation)
        first = self.rotation[:n], self.translation[:n]
        self.mask = store.input(
            "mask", (n, 1, h, w), lambda rng: well_conditioned(rng, self.camera, self.depth_s, self.flow, *first)
        ).bool()
