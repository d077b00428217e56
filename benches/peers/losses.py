"""Each loss by itself, forward and backward, written as users of PyTorch do: vectorised, no loops over pixels."""

import torch
import torch.nn.functional as F

import geometric
import photometric
import scene

# Weights of red, green and blue in a grey value from 0 to 255.
GREY = (255 * 0.2989, 255 * 0.5870, 255 * 0.1140)
# Ratio of pseudo-depths from which on an order is trusted, and the share of the pixels that are compared.
TRUSTED, COMPARED = 1.15, 0.1


def codes(image):
    """Census codes [n, 9, h, w]: differences from the middle of each 3x3 window, squashed; grey 0 outside."""
    n, _, h, w = image.shape
    grey = (image * image.new_tensor(GREY).reshape(1, 3, 1, 1)).sum(1, keepdim=True)
    difference = F.unfold(grey, 3, padding=1).reshape(n, 9, h, w) - grey
    return difference / (0.81 + difference.square()).sqrt()


def census(image, target, mask):
    """Mean distance of the codes of two images, ARFlow's form; windows over the border do not count."""
    squares = (codes(image) - codes(target)).square()
    distance = (squares / (0.1 + squares)).mean(1, keepdim=True)
    return (distance * F.pad(mask[..., 1:-1, 1:-1], (1, 1, 1, 1))).mean()


def normals(camera, depth):
    """Unit normals [n, 3, h, w] of a depth map: cross product of Sobel differences of its points, borders repeated."""
    n, _, h, w = depth.shape
    points = F.pad(depth * camera.rays.reshape(1, 3, h, w), (1, 1, 1, 1), mode="replicate")
    sobel = depth.new_tensor([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]]).div(8).expand(3, 1, 3, 3)
    du, dv = F.conv2d(points, sobel, groups=3), F.conv2d(points, sobel.transpose(2, 3), groups=3)
    return F.normalize(torch.linalg.cross(du, dv, dim=1), dim=1)


def normal_matching(camera, depth, pseudo):
    """Mean absolute difference of the normals."""
    with torch.no_grad():
        wanted = normals(camera, pseudo)
    return (normals(camera, depth) - wanted).abs().mean()


def depth_ranking(depth, pseudo, first, second):
    """Logistic loss of the order of pairs of pixels where the pseudo-depth is sure of it."""
    depth, pseudo = depth.flatten(), pseudo.flatten()
    quotient = pseudo[first] / pseudo[second]
    order = (quotient > TRUSTED).float() - (1 / quotient > TRUSTED).float()
    kept = order != 0
    return F.softplus(-order[kept] * (depth[first[kept]] - depth[second[kept]])).mean()


def ranking_pairs(store, h, w):
    """A random tenth of the pixels against its permutation: two lists of indices."""
    mask = store.input("ranking_mask", (h * w,), lambda rng: rng.random(h * w) < COMPARED).bool()
    permutation = store.input("ranking_permutation", (h * w,), lambda rng: rng.permutation(h * w)).long()
    return mask.nonzero()[:, 0], mask[permutation].nonzero()[:, 0]


def cross_task(rigid, optical, mask):
    """Mean difference of two flows."""
    return ((rigid - optical).abs() * mask).sum() / (mask.sum() + 1e-3)


def build(case, variant, store):
    """`case`: name, loss, options of it, names of what takes a gradient, height, width."""
    del variant
    h, w = case["height"], case["width"]
    target, _, following = scene.images(store, 1, h, w)
    pair = geometric.Pair(store, 1, h, w)
    camera, depth_s, chosen = pair.camera, pair.depth_s, pair.mask
    mask = chosen.float()
    pairs = ranking_pairs(store, h, w)
    leaves = {
        "next": following,
        "depth_t": pair.depth_t,
        "depth_s": depth_s,
        "flow": pair.flow,
        "other_flow": scene.flow(store, "other_flow", pair.depth_t, pair.translation),
        # Of both sources the first.
        "rotation": pair.rotation[:1].clone(),
        "translation": pair.translation[:1].clone(),
    }
    leaves = {name: leaves[name].requires_grad_() for name in case["leaves"]}
    options = case["options"] or {}

    losses = {
        "geometric": lambda depth_t, depth_s, rotation, translation: sum(
            geometric.losses(camera, depth_t, depth_s, pair.flow, rotation, translation, chosen, **options)
        ),
        "photometric": lambda image: photometric.error(image, target).mean(),
        "smoothness": lambda depth: photometric.smoothness(1.0 / depth, target),
        "census": lambda image: census(image, target, mask),
        "normal_matching": lambda depth: normal_matching(camera, depth, depth_s),
        "depth_ranking": lambda depth: depth_ranking(depth, depth_s, *pairs),
        "cross_task": lambda rigid, optical: cross_task(rigid, optical, mask),
    }
    loss = losses[case["loss"]]

    def forward_backward():
        for leaf in leaves.values():
            leaf.grad = None
        value = loss(*leaves.values())
        value.backward()
        return value

    value = forward_backward().item()
    for name, leaf in leaves.items():
        # Without a path to the leaf it is zero.
        store.result(f"grad_{name}", torch.zeros_like(leaf) if leaf.grad is None else leaf.grad)
    return {"forward_backward": forward_backward}, {"loss": value}
