"""Photometric error over rigid flow, and edge-aware smoothness, as Monodepth2 has them."""

import torch
import torch.nn.functional as F

# Points nearer than this are not projected.
Z_MIN = 1e-3


class Camera:
    """Pixel grid and rays of a pinhole camera without skew."""

    def __init__(self, matrix, h, w):
        v, u = torch.meshgrid(torch.arange(h, dtype=torch.float32), torch.arange(w, dtype=torch.float32), indexing="ij")
        self.h, self.w, self.matrix = h, w, matrix
        self.pixels = torch.stack([u, v])[None]
        self.inverse = torch.linalg.inv(matrix.double()).float()
        self.rays = (self.inverse.double() @ torch.cat([self.pixels.reshape(2, -1), torch.ones(1, h * w)]).double()).float()
        self.centre = matrix[:2, 2].reshape(1, 2, 1, 1)
        self.focal = torch.stack([matrix[0, 0], matrix[1, 1]]).reshape(1, 2, 1, 1)
        self.offset = self.pixels - self.centre
        self.radius = self.offset.norm(dim=1, keepdim=True)

    def sample(self, image, xy):
        """The image read at pixel coordinates [n, 2, h, w]: bilinear, border values outside."""
        grid = torch.stack([(xy[:, 0] + 0.5) * (2.0 / self.w) - 1.0, (xy[:, 1] + 0.5) * (2.0 / self.h) - 1.0], dim=-1)
        return F.grid_sample(image, grid, mode="bilinear", padding_mode="border", align_corners=False)

    def warp(self, depth, rotation, translation, source):
        """The source as seen from the target: back-project, move, project, read."""
        points = rotation @ (depth.reshape(len(depth), 1, -1) * self.rays) + translation[:, :, None]
        seen = (self.matrix @ points).reshape(len(depth), 3, self.h, self.w)
        return self.sample(source, seen[:, :2] / seen[:, 2:].clamp(min=Z_MIN))


def error(x, y):
    """0.85 (1 - SSIM) / 2 + 0.15 |x - y|, mean over the channels; 3x3 means with mirrored borders."""
    px, py = F.pad(x, (1, 1, 1, 1), mode="reflect"), F.pad(y, (1, 1, 1, 1), mode="reflect")
    mx, my = F.avg_pool2d(px, 3, 1), F.avg_pool2d(py, 3, 1)
    sx = F.avg_pool2d(px * px, 3, 1) - mx * mx
    sy = F.avg_pool2d(py * py, 3, 1) - my * my
    sxy = F.avg_pool2d(px * py, 3, 1) - mx * my
    c1, c2 = 0.01**2, 0.03**2
    ssim = ((2 * mx * my + c1) * (2 * sxy + c2)) / ((mx * mx + my * my + c1) * (sx + sy + c2))
    dissimilarity = ((1 - ssim) / 2).clamp(0, 1).mean(1, keepdim=True)
    return 0.85 * dissimilarity + 0.15 * (x - y).abs().mean(1, keepdim=True)


def minimum_reprojection(camera, depth, rotation, translation, target, sources, identities):
    """Mean of the smallest error over the warped sources and the unwarped ones (`identities`, without gradient)."""
    n = len(target)
    warped = [
        error(camera.warp(depth, rotation[i * n : (i + 1) * n], translation[i * n : (i + 1) * n], source), target)
        for i, source in enumerate(sources)
    ]
    return torch.cat(identities + warped, 1).min(1).values.mean()


def identity_errors(target, sources):
    """Errors of the unwarped sources."""
    with torch.no_grad():
        return [error(source, target) for source in sources]


def smoothness(disparity, image):
    """Steps of the disparity over its mean, excused where the image has steps too."""
    disparity = disparity / (disparity.mean((2, 3), keepdim=True) + 1e-7)
    dx = (disparity[..., 1:] - disparity[..., :-1]).abs()
    dy = (disparity[..., 1:, :] - disparity[..., :-1, :]).abs()
    ix = (image[..., 1:] - image[..., :-1]).abs().mean(1, keepdim=True)
    iy = (image[..., 1:, :] - image[..., :-1, :]).abs().mean(1, keepdim=True)
    return (dx * torch.exp(-ix)).mean() + (dy * torch.exp(-iy)).mean()
