"""Makes the numbers in *.f64.safetensors anew from the inputs in the same files, and compares.

A second program in NumPy with the package `autograd` (reverse-mode gradients), independent of the Rust code and of PyTorch,
which made the stored numbers. `pip install numpy autograd`, then `python3 check_losses.py` in this folder: one line for each
file with the largest distance, relative to the largest magnitude of the tensor; ends with 1 when one is above 1e-8.
Every formula below is the definition of the tensors it returns.
"""

import json
import sys
import warnings

import autograd.numpy as np
import numpy
from autograd import grad

TYPES = {"F64": "<f8", "I32": "<i4", "U8": "u1"}
LIMIT = 1e-8
H, W = 24, 32
V, U = numpy.mgrid[0:H, 0:W].astype(float)
Z_MIN, Q_MIN, TAU_F, TAU_RHO, GATE, TAU_T, KAPPA = 1e-3, 1.0, 0.1, 0.1, 2.0, 1e-3, 0.05


def read(name):
    content = open(f"{name}.f64.safetensors", "rb").read()
    start = 8 + int.from_bytes(content[:8], "little")
    header = json.loads(content[8:start])
    header.pop("__metadata__", None)
    at = lambda entry: content[start + entry["data_offsets"][0] : start + entry["data_offsets"][1]]
    return {k: numpy.frombuffer(at(e), TYPES[e["dtype"]]).reshape(e["shape"]).astype(float) for k, e in header.items()}


def root(x):
    """Square root whose derivative at 0 is 0."""
    positive = x > 0
    return np.where(positive, np.sqrt(np.where(positive, x, 1.0)), 0.0)


def each(f, *batches):
    """The stacked results of f on the elements of a batch."""
    return np.stack([f(*one) for one in zip(*batches)])


# Poses and sampling, for one sample.


def rotation(w):
    """Axis-angle to matrix with the guarded axis w / (|w| + 1e-7)."""
    angle = root(np.sum(w**2))
    x, y, z = w / (angle + 1e-7)
    cross = np.array([[0 * x, -z, y], [z, 0 * x, -x], [-y, x, 0 * x]])
    axis = np.array([x, y, z])
    return np.cos(angle) * np.eye(3) + (1 - np.cos(angle)) * np.outer(axis, axis) + np.sin(angle) * cross


def euler(x):
    """Rx Ry Rz."""
    (a, b, c), zero, one = x, 0 * x[0], 0 * x[0] + 1
    cos, sin = np.cos, np.sin
    rx = np.array([[one, zero, zero], [zero, cos(a), -sin(a)], [zero, sin(a), cos(a)]])
    ry = np.array([[cos(b), zero, sin(b)], [zero, one, zero], [-sin(b), zero, cos(b)]])
    rz = np.array([[cos(c), -sin(c), zero], [sin(c), cos(c), zero], [zero, zero, one]])
    return rx @ ry @ rz


def project(k, points, r, tau):
    """K (R X + t) of points (3,H,W)."""
    return np.tensordot(k, np.tensordot(r, points, 1) + tau.reshape(3, 1, 1), 1)


def pixels(y):
    """The first two rows divided by the third + 1e-7."""
    return y[:2] / (y[2:] + 1e-7)


def half_pixel(p):
    """Where align_corners=False reads for the pixels p that were divided by (size - 1) / 2."""
    size = numpy.array([W, H]).reshape(2, 1, 1)
    return ((p / (size - 1) * 2) * size - 1) / 2


def grid(p):
    """Pixels (N,2,H,W) in -1..1, axis last."""
    return np.moveaxis(2 * (p / numpy.array([W - 1, H - 1]).reshape(2, 1, 1) - 0.5), 1, -1)


def rays(k):
    return np.stack([(U - k[0, 2]) / k[0, 0], (V - k[1, 2]) / k[1, 1], np.ones((H, W))])


def sample(image, x, y, padding):
    """Bilinear sampling of (C,H,W) at columns x and rows y."""
    if padding == "border":
        x, y = np.clip(x, 0, W - 1), np.clip(y, 0, H - 1)
    value = lambda part: numpy.asarray(getattr(part, "_value", part))
    x0, y0 = numpy.floor(value(x)).astype(int), numpy.floor(value(y)).astype(int)
    a, b = x - x0, y - y0
    total = 0.0
    for dx, wx in ((0, 1 - a), (1, a)):
        for dy, wy in ((0, 1 - b), (1, b)):
            u, v = x0 + dx, y0 + dy
            inside = (u >= 0) & (u < W) & (v >= 0) & (v < H)
            total = total + image[:, v.clip(0, H - 1), u.clip(0, W - 1)] * (wx * wy * inside)
    return total


def gradients(f, inputs):
    """Gradients of the scalar f(*inputs) by each input."""
    return [grad(f, i)(*inputs) for i in range(len(inputs))]


def pose(t):
    def transforms(w, tau):
        r, tau = rotation(w[0]), tau[0].reshape(3, 1)
        last = np.array([[0.0, 0.0, 0.0, 1.0]])
        plain = np.concatenate([np.concatenate([r, tau], 1), last])
        return plain, np.concatenate([np.concatenate([r.T, -r.T @ tau], 1), last])

    def loss(w, tau):
        t_plain, t_inv = (each(lambda *a: transforms(*a)[i], w, tau) for i in (0, 1))
        return np.sum(t_plain * t["in.w"]) + np.sum(t_inv * t["in.w_inv"])

    inputs = t["in.axisangle"], t["in.translation"]
    by_w, by_tau = gradients(loss, inputs)
    return {
        "out.R_euler": each(euler, t["in.euler"]),
        "grad.euler": grad(lambda x: np.sum(each(euler, x) * t["in.w_euler"]))(t["in.euler"]),
        "out.T": each(lambda *a: transforms(*a)[0], *inputs),
        "out.T_inv": each(lambda *a: transforms(*a)[1], *inputs),
        "grad.axisangle": by_w,
        "grad.translation": by_tau,
    }


def warp(t):
    def projected(k, depth, w, tau):
        return project(k, rays(k) * depth, rotation(w[0]), tau[0])

    def warped(image, depth, w, tau, padding, place):
        one = lambda k, i, *motion: sample(i, *place(pixels(projected(k, *motion))), padding)
        return each(one, t["in.K"], image, depth, w, tau)

    inputs = t["in.image"], t["in.depth"], t["in.axisangle"], t["in.translation"]
    y = each(projected, t["in.K"], *inputs[1:])
    pix = each(pixels, y)
    out = {"out.pix": pix, "out.computed_depth": y[:, 2:], "out.grid": grid(pix), "out.rigid_flow": pix - numpy.stack([U, V])}
    out["out.cam_points"] = each(lambda k, d: rays(k) * d, t["in.K"], t["in.depth"])
    for padding in ("border", "zeros"):
        for corners, place in (("ac1", lambda p: p), ("ac0", half_pixel)):
            out[f"out.warped_{padding}_{corners}"] = warped(*inputs, padding, place)
            loss = lambda *a: np.sum(warped(*a, padding, place) * t["in.w"])
            for name, value in zip(("image", "depth", "axisangle", "translation"), gradients(loss, inputs)):
                out[f"grad_{padding}_{corners}.{name}"] = value
    return out


# Images.


def box(x, k):
    """Mean over k x k pixels of (N,C,H,W), the border mirrored without repeating its pixels."""
    h, w = x.shape[2:]
    rows, columns = (numpy.pad(numpy.arange(n), k // 2, mode="reflect") for n in (h, w))
    x = sum(x[:, :, rows[i : i + h]] for i in range(k)) / k
    return sum(x[:, :, :, columns[i : i + w]] for i in range(k)) / k


def dissimilarity(x, y, k):
    """clamp((1 - SSIM) / 2, 0, 1) for each channel."""
    c1, c2 = 0.01**2, 0.03**2
    mx, my = box(x, k), box(y, k)
    vx, vy, c = box(x * x, k) - mx**2, box(y * y, k) - my**2, box(x * y, k) - mx * my
    ssim = (2 * mx * my + c1) * (2 * c + c2) / ((mx**2 + my**2 + c1) * (vx + vy + c2))
    return np.clip((1 - ssim) / 2, 0, 1)


def photo(x, y):
    return 0.85 * np.mean(dissimilarity(x, y, 3), 1, keepdims=True) + 0.15 * np.mean(np.abs(y - x), 1, keepdims=True)


def ssim(t):
    out = {}
    inner = lambda *a: dissimilarity(*a, 3)[:, :, 1:-1, 1:-1]
    for name, f in (("dissim3", lambda *a: dissimilarity(*a, 3)), ("dissim7", lambda *a: dissimilarity(*a, 7)), ("dissim3_valid", inner)):
        out[f"out.{name}"] = f(t["in.x"], t["in.y"])
        loss = lambda x, y: np.sum(f(x, y) * t[f"in.w_{name}"])
        out[f"grad_{name}.x"], out[f"grad_{name}.y"] = gradients(loss, (t["in.x"], t["in.y"]))
    return out


def photometric(t):
    inputs = t["in.pred"], t["in.target"]
    by_pred, by_target = gradients(lambda *a: np.mean(photo(*a)), inputs)
    error = photo(*inputs)
    l1 = np.mean(np.abs(inputs[1] - inputs[0]), 1, keepdims=True)
    return {"out.l1": l1, "out.photo": error, "out.loss": np.mean(error), "grad.pred": by_pred, "grad.target": by_target}


def min_reproj(t):
    target = t["in.target"]
    unmoved = [photo(t[f"in.src_{s}"], target) for s in ("prev", "next")]
    lowest = lambda a, b, more: np.min(np.concatenate([*more, photo(a, target), photo(b, target)], 1), 1)
    inputs = t["in.warped_prev"], t["in.warped_next"]
    reprojection = np.concatenate([photo(x, target) for x in inputs], 1)
    which = np.argmin(np.concatenate([*unmoved, reprojection], 1), 1)
    out = {"out.min": lowest(*inputs, unmoved), "out.argmin": which, "out.automask": which >= 2}
    out |= {"out.reprojection": reprojection, "out.identity": np.concatenate(unmoved, 1), "out.loss_avg": np.mean(reprojection)}
    for more, value, prefix in ((unmoved, "loss", "grad"), ([], "loss_no_automask", "grad_no_automask")):
        loss = lambda a, b: np.mean(lowest(a, b, more))
        out[f"out.{value}"] = loss(*inputs)
        out[f"{prefix}.warped_prev"], out[f"{prefix}.warped_next"] = gradients(loss, inputs)
    return out


def edge_aware(x, image):
    """First differences weighted by exp(-mean_c |image difference|)."""
    step = lambda x, axis: np.abs(np.diff(x, axis=axis))
    edge = lambda axis: np.exp(-np.mean(step(image, axis), 1, keepdims=True))
    return np.mean(step(x, 3) * edge(3)) + np.mean(step(x, 2) * edge(2))


def edge_aware_normalised(x, image):
    return edge_aware(x / (np.mean(x, (2, 3), keepdims=True) + 1e-7), image)


def smoothness(t):
    out, inputs = {}, (t["in.disp"], t["in.image"])
    for name, loss in (("raw", edge_aware), ("normalised", edge_aware_normalised)):
        out[f"out.{name}"] = loss(*inputs)
        out[f"grad_{name}.disp"], out[f"grad_{name}.image"] = gradients(loss, inputs)
    return out


def disp_depth(t):
    scaled = lambda d: 0.01 + 9.99 * d
    loss = lambda d: np.sum(t["in.w"] / scaled(d))
    d = t["in.disp"]
    return {"out.scaled_disp": scaled(d), "out.depth": 1 / scaled(d), "grad.disp": grad(loss)(d)}


def resized(x):
    """(N,1,h,w) to H x W, bilinear between half-pixel centres."""
    for axis, size in ((2, H), (3, W)):
        old = x.shape[axis]
        at = numpy.maximum((numpy.arange(size) + 0.5) * old / size - 0.5, 0)
        low = numpy.floor(at).astype(int)
        weights = numpy.zeros((size, old))
        weights[numpy.arange(size), low] += 1 - (at - low)
        weights[numpy.arange(size), (low + 1).clip(0, old - 1)] += at - low
        x = np.moveaxis(np.tensordot(weights, x, ((1,), (axis,))), 0, axis)
    return x


def monodepth_total(t):
    target, names = t["in.color_0"], ["prev", "next"]
    unmoved = [photo(t[f"in.src_{s}"], target) for s in names]

    def scale(s, disparity, motions):
        depth = 1 / (0.01 + 9.99 * resized(disparity))
        errors = []
        for source, (w, tau) in zip(names, motions):

            def one(k, image, depth, w, tau):
                r = rotation(w[0])
                r, tau = (r.T, -r.T @ tau[0]) if source == "prev" else (r, tau[0])
                return sample(image, *pixels(project(k, rays(k) * depth, r, tau)), "border")

            errors.append(photo(each(one, t["in.K"], t[f"in.src_{source}"], depth, w, tau), target))
        lowest = np.min(np.concatenate([*unmoved, *errors], 1), 1)
        return np.mean(lowest), edge_aware_normalised(disparity, t[f"in.color_{s}"])

    def total(*leaves):
        parts = [scale(s, leaves[s], (leaves[4:6], leaves[6:8])) for s in range(4)]
        return sum(photo + 1e-3 * smooth / 2**s for s, (photo, smooth) in enumerate(parts)) / 4

    leaves = [f"disp_{s}" for s in range(4)] + ["axisangle_prev", "translation_prev", "axisangle_next", "translation_next"]
    inputs = [t[f"in.{leaf}"] for leaf in leaves]
    out = {"out.total": total(*inputs)}
    for s in range(4):
        out[f"out.photo_{s}"], out[f"out.smooth_{s}"] = scale(s, inputs[s], (inputs[4:6], inputs[6:8]))
    return out | {f"grad.{leaf}": value for leaf, value in zip(leaves, gradients(total, inputs))}


# Pairs of views, normals and pseudo-depth.


def sc_geometry(t):
    leaves = ["tgt_depth", "ref_depth", "pose", "ref_img"]
    inputs = [t[f"in.{leaf}"] for leaf in leaves]
    image, over = t["in.tgt_img"], lambda x: np.mean(x, 1, keepdims=True)

    def seen(maps, tgt_depth, ref_depth, pose, ref_img):
        def one(k, d_t, d_r, p, i_r):
            y = project(k, rays(k) * d_t, euler(p[3:]), p[:3])
            if maps is later:
                z, p = y[2:], pixels(y)
            else:
                z = np.clip(y[2:], 1e-3, None)
                p = y[:2] / z
                largest = numpy.array([W - 1, H - 1]).reshape(2, 1, 1)
                p = np.where((p >= 0) & (p <= largest), p, 1.5 * largest)
            return np.concatenate([p, z, sample(np.concatenate([i_r, d_r]), *half_pixel(p), "zeros")])

        made = each(one, t["in.K"], tgt_depth, ref_depth, pose, ref_img)
        return maps(*(made[:, a:b] for a, b in ((0, 2), (2, 3), (3, 6), (6, 7))), ref_img)

    def later(pix, computed, warped, projected, ref_img):
        depth = np.abs(computed - projected) / (computed + projected)
        colour = over(np.abs(image - warped))
        auto = constant(colour) < over(numpy.abs(image - constant(ref_img)))
        valid = auto & (constant(over(np.abs(warped))) > 1e-3) & (over(numpy.abs(image)) > 1e-3)
        error = over(0.15 * np.clip(np.abs(image - warped), 0, 1) + 0.85 * dissimilarity(image, warped, 7))
        return {
            "pix": pix, "warped": warped, "computed": computed, "projected": projected, "diff_depth": depth, "auto": auto,
            "diff_color": colour, "valid": valid, "diff_img": error * (1 - constant(depth)),
        }  # fmt: skip

    def first(pix, computed, warped, projected, ref_img):
        depth = np.clip(np.abs(computed - projected) / (computed + projected), 0, 1)
        a = np.clip(np.abs(image - warped), 0, 1)
        view = ((constant(pix)[:, 0] <= W - 1) & (constant(pix)[:, 1] <= H - 1))[:, None]
        valid = view & (constant(over(a)) < over(numpy.abs(image - constant(ref_img))))
        error = (0.15 * a + 0.85 * dissimilarity(image, warped, 3)) * (1 - depth)
        return {
            "grid": grid(pix), "warped": warped, "computed": computed, "projected": projected, "diff_depth": depth,
            "valid": view, "mask": valid, "diff_img": error,
        }  # fmt: skip

    out = {}
    for prefix, maps, mask in (("pl", later, "valid"), ("rel", first, "mask")):
        out |= {f"out.{prefix}_{name}": constant(value) for name, value in seen(maps, *inputs).items()}
        for name, of in (("photo", "diff_img"), ("geometry", "diff_depth")):

            def loss(*a):
                found = seen(maps, *a)
                chosen = numpy.broadcast_to(found[mask], found[of].shape)
                return np.sum(found[of] * chosen) / chosen.sum()

            out[f"out.{prefix}_{name}"] = loss(*inputs)
            for leaf, value in zip(leaves, gradients(loss, inputs)):
                out[f"grad_{prefix}_{name}.{leaf}"] = value
    return out


def rectify(t):
    def turned(k, angles):
        return pixels(project(k, rays(k), euler(angles), numpy.zeros(3)))

    warped = lambda image, angles: each(lambda k, i, a: sample(i, *turned(k, a), "zeros"), t["in.K"], image, angles)
    loss = lambda *a: np.sum(warped(*a) * t["in.w"])
    by_image, by_angles = gradients(loss, (t["in.image"], t["in.rot"]))
    consistency = lambda r1, r2, r3: np.mean(np.abs(r3 - t["in.rot3_gt"]))
    triplet = lambda r1, r2, r3: np.mean(np.maximum(np.abs(r2) - np.abs(r1) + 0.05, 0))
    said = [t[f"in.rot{i}"] for i in (1, 2, 3)]
    out = {"out.rot_consistency": consistency(*said), "out.rot_triplet": triplet(*said)}
    for i, value in enumerate(gradients(lambda *a: consistency(*a) + triplet(*a), said)):
        out[f"grad_rot.rot{i + 1}"] = value
    pix = each(turned, t["in.K"], t["in.rot"])
    return out | {"out.pix": pix, "out.warped": warped(t["in.image"], t["in.rot"]), "grad.image": by_image, "grad.rot": by_angles}


def normal_map(k, depth):
    points = rays(k) * depth
    padded = lambda x: x[:, numpy.arange(-1, H + 1).clip(0, H - 1)][:, :, numpy.arange(-1, W + 1).clip(0, W - 1)]
    p = padded(points)
    rows, columns = p[:, :-2] + 2 * p[:, 1:-1] + p[:, 2:], p[:, :, :-2] + 2 * p[:, :, 1:-1] + p[:, :, 2:]
    du, dv = (rows[:, :, 2:] - rows[:, :, :-2]) / 8, (columns[:, 2:] - columns[:, :-2]) / 8
    n = np.stack([du[i] * dv[j] - du[j] * dv[i] for i, j in ((1, 2), (2, 0), (0, 1))])
    return n / np.maximum(root(np.sum(n**2, 0)), 1e-12)


def normals(t):
    loss = lambda depth: np.sum(each(normal_map, t["in.K"], depth) * t["in.w"])
    return {"out.normals": each(normal_map, t["in.K"], t["in.depth"]), "grad.depth": grad(loss)(t["in.depth"])}


def responses(x):
    """Of (C,H,W) along u and, upwards, along v, in the inner pixels."""
    rows, columns = x[:, :-2] + 2 * x[:, 1:-1] + x[:, 2:], x[:, :, :-2] + 2 * x[:, :, 1:-1] + x[:, :, 2:]
    return rows[:, :, 2:] - rows[:, :, :-2], columns[:, :-2] - columns[:, 2:]


def edges(gx, gy):
    return [numpy.pad(x, 1) for x in (numpy.sqrt(gx**2 + gy**2), numpy.arctan2(gy, gx))]


def lines(strength, theta, ranks, offsets):
    """Both ends of the pairs on the lines through the anchors."""
    anchors = numpy.flatnonzero(strength >= 0.1 * strength.max())[ranks.astype(int)]
    angle = theta.ravel()[anchors]
    signed = offsets * numpy.array([-1, -1, 1, 1])[:, None]
    u = (anchors % W + numpy.round(signed * numpy.abs(numpy.cos(angle)))).clip(0, W - 1)
    v = (anchors // W + numpy.round(signed * numpy.abs(numpy.sin(angle)))).clip(0, H - 1)
    points = (v * W + u).astype(int)
    return points[:3].ravel(), points[1:].ravel()


def lsr(t):
    depth, pseudo = t["in.depth"], t["in.pseudo_depth"]
    n = lambda d: each(normal_map, t["in.K"], d)
    wanted, matching = n(pseudo), lambda d: np.mean(np.abs(n(d) - n(pseudo)))
    out = {"out.normals": n(depth), "out.pseudo_normals": wanted, "out.normal_matching": matching(depth)}
    out["grad_normal_matching.depth"] = grad(matching)(depth)

    of_depth = numpy.stack([edges(*(g[0] for g in responses(d)))[0] for d in pseudo])
    strong = numpy.pad(of_depth >= 0.1 * of_depth.max(), ((0, 0), (1, 1), (1, 1)))
    grown = numpy.max([strong[:, i : i + H, j : j + W] for i in range(3) for j in range(3)], 0)
    framed = (V < 5) | (U < 5) | (V >= H - 5) | (U >= W - 5)
    pairs = []
    for b in (0, 1):
        ends = []
        image = edges(*(g[0] for g in responses(t["in.image"][b])))
        normal = edges(*(numpy.abs(g).mean(0) for g in responses(wanted[b])))
        for name, (strength, theta), dropped in (("image", image, grown[b]), ("normal", normal, grown[b] | framed)):
            strength = numpy.where(dropped, 0.0, strength)
            out.setdefault(f"out.edge_{name}", []).append([strength])
            out.setdefault(f"out.theta_{name}", []).append([theta])
            ends.append(lines(strength, theta, t[f"in.{name}_rank_{b}"], t[f"in.{name}_distance_{b}"]))
            out[f"out.{name}_pair_a_{b}"], out[f"out.{name}_pair_b_{b}"] = ends[-1]
        pairs.append([numpy.concatenate(side) for side in zip(*ends)])
    out["out.depth_edge_dilated"] = grown[:, None]

    def relative(d):
        def cosines(n):
            flat = n.reshape(2, 3, H * W)
            return np.concatenate([np.abs(np.sum(flat[b][:, i] * flat[b][:, j], 0)) for b, (i, j) in enumerate(pairs)])

        return np.mean(np.abs(cosines(wanted) - cosines(n(d))))

    out["out.relative_normal"], out["grad_relative_normal.depth"] = relative(depth), grad(relative)(depth)
    return out | ranking(t, depth, pseudo)


def ranking(t, depth, pseudo):
    mask = t["in.rank_mask_a"].ravel() > 0
    common = numpy.flatnonzero(mask), numpy.flatnonzero(mask[t["in.rank_perm"].astype(int)])
    out, found = {}, []
    for b in (0, 1):
        low = numpy.zeros(H * W, bool)
        low[numpy.argsort(t["in.dynamic_weight"][b].ravel(), kind="stable")[: int(0.2 * H * W)]] = True
        out[f"out.unreliable_{b}"] = low.reshape(H, W)
        own = numpy.flatnonzero(low), numpy.flatnonzero(~low)[t[f"in.rank_pick_{b}"].astype(int)]
        for (i, j), inclusive in ((common, False), (own, True)):
            ratio = pseudo[b].ravel()[i] / pseudo[b].ravel()[j]
            order = numpy.where(ratio > 1.15, 1, numpy.where(1 / ratio > 1.15, -1, 0))
            order = numpy.where((ratio == 1.15) & inclusive, 1, order)
            found.append((b, i[order != 0], j[order != 0], order[order != 0]))

    def loss(d):
        flat = d.reshape(2, H * W)
        terms = [np.log(1 + np.exp(-order * (flat[b][i] - flat[b][j]))) for b, i, j, order in found]
        return np.mean(np.concatenate(terms))

    return out | {"out.depth_ranking": loss(depth), "grad_depth_ranking.depth": grad(loss)(depth)}


def pseudo_guided(t):
    def mean(x, r=4):
        window = lambda i, n: slice(max(i - r, 0), min(i + r, n - 1) + 1)
        return numpy.array([[x[window(v, H), window(u, W)].mean() for u in range(W)] for v in range(H)])

    def one(depth, image):
        guide = luminance(image)
        y = 1 / depth[0]
        y = y / (y.mean() + 1e-7)
        a = (mean(guide * y) - mean(guide) * mean(y)) / (mean(guide**2) - mean(guide) ** 2 + 1e-3)
        b = mean(y) - a * mean(guide)
        return (mean(a) * guide + mean(b))[None]

    luminance = lambda image: numpy.tensordot([0.2989, 0.5870, 0.1140], image, 1)
    filtered = each(one, t["in.depth"], t["in.image"])
    guide = each(luminance, t["in.image"])[:, None]
    return {"out.guide": guide, "out.filtered": filtered, "out.pseudo_depth": 1 / numpy.maximum(filtered, 1e-3)}


# Flows.


def in_view(flow):
    x, y = U + flow[0], V + flow[1]
    return (x >= 0) & (x <= W - 1) & (y >= 0) & (y <= H - 1)


def range_map(flow):
    """How many ones, moved along a flow and shared bilinearly among four pixels, arrive at each pixel."""
    out = numpy.zeros((1, H, W))
    x, y = U + flow[0], V + flow[1]
    x0, y0 = numpy.floor(x).astype(int), numpy.floor(y).astype(int)
    for u, v in ((x0, y0), (x0 + 1, y0), (x0, y0 + 1), (x0 + 1, y0 + 1)):
        inside = (u >= 0) & (u < W) & (v >= 0) & (v < H)
        share = (1 - abs(x - u)) * (1 - abs(y - v))
        numpy.add.at(out[0], (v[inside], u[inside]), share[inside])
    return out


def flow_masks(t):
    forward, rigid = t["in.flow_fw"], t["in.rigid_flow"]
    back = each(lambda f, b: sample(b, U + f[0], V + f[1], "zeros"), forward, t["in.flow_bw"])
    square = lambda x: numpy.sum(x**2, 1, keepdims=True)
    moved = square(rigid - forward)[:, 0]
    grid = numpy.array([2 / (W - 1), 2 / (H - 1)]).reshape(1, 2, 1, 1)
    grid_moved = square((rigid - forward) * grid)[:, 0]
    deviation, allowed = square(forward + back), 0.01 * (square(forward) + square(back)) + 0.5
    reached = each(range_map, t["in.flow_bw"])
    return {
        "out.bw_warped": back,
        "out.fb_sq": deviation,
        "out.fb_threshold": allowed,
        "out.occluded_fb": deviation > allowed,
        "out.dfvo_norm": numpy.sqrt(deviation),
        "out.in_view": each(in_view, forward)[:, None],
        "out.range_map": reached,
        "out.occluded_range_020": reached < 0.2,
        "out.dynamo_mag": grid_moved,
        "out.dynamo_static": grid_moved < grid_moved.mean(),
        "out.static_px_per_image": moved < moved.mean((1, 2), keepdims=True),
    }


def dynamo(t):
    logit, residual = t["in.logit"], t["in.residual_flow"]
    mask = lambda logit: 1 / (1 + np.exp(-logit))
    weight = (t["in.disp"] > 0.03) * (1 - mask(logit))
    distance = numpy.sum((t["in.grid_ego"] - t["in.grid_complete"]) ** 2, -1)[:, None]
    static = distance < distance.mean()
    sparsity = lambda logit: np.sum(np.log(1 + np.exp(logit)) * static) / static.sum()
    consistency = lambda residual: np.mean(weight * np.abs(residual))
    smooth = lambda logit: edge_aware(mask(logit), t["in.image"])
    return {
        "out.mask": mask(logit),
        "out.c_consistency": consistency(residual),
        "grad_c_consistency.residual_flow": grad(consistency)(residual),
        "grad_c_consistency.logit": numpy.zeros_like(logit),
        "out.static": static,
        "out.m_sparsity": sparsity(logit),
        "grad_m_sparsity.logit": grad(sparsity)(logit),
        "out.m_smooth": smooth(logit),
        "grad_m_smooth.logit": grad(smooth)(logit),
    }


def census(a, b, r):
    """Distance of the soft census codes, summed over windows of 2 r + 1 pixels; cells outside are 0."""

    def codes(image):
        grey = 255 * (0.2989 * image[:, :1] + 0.5870 * image[:, 1:2] + 0.1140 * image[:, 2:])
        padded = np.pad(grey, ((0, 0), (0, 0), (r, r), (r, r)), "constant")
        steps = [padded[:, :, i : i + H, j : j + W] - grey for i in range(2 * r + 1) for j in range(2 * r + 1)]
        return [d / np.sqrt(0.81 + d**2) for d in steps]

    return sum((x - y) ** 2 / (0.1 + (x - y) ** 2) for x, y in zip(codes(a), codes(b)))


def flow_losses(t):
    a, b, flow = t["in.image_a"], t["in.image_b"], t["in.flow"]
    inner = lambda r: ((U >= r) & (U < W - r) & (V >= r) & (V < H - r))[None, None]
    mask = t["in.mask"] * inner(3)
    map3 = lambda b: census(a, b, 1) / 9 * inner(1)
    census3 = lambda b: np.mean(map3(b))
    census7 = lambda b: np.sum((census(a, b, 3) + 0.01) ** 0.4 * mask) / np.sum(mask + 1e-6)
    out = {
        "out.census3_map": map3(b),
        "out.census3": census3(b),
        "grad_census3.image_b": grad(census3)(b),
        "out.census7_hamming": census(a, b, 3),
        "out.census7": census7(b),
        "grad_census7.image_b": grad(census7)(b),
        "out.ternary_unflow_r3": np.sum((census(a, b, 3) ** 2 + 1e-6) ** 0.45 * mask) / (2 * H * W),
    }

    def second(flow, axis):
        return np.diff(flow, n=2, axis=axis)

    def arflow(flow):
        edge = lambda axis: np.exp(-10 * np.mean(np.abs(np.diff(a, axis=axis)), 1, keepdims=True))
        by_x, by_y = edge(3)[:, :, :, 1:] * np.abs(second(flow, 3)), edge(2)[:, :, 1:] * np.abs(second(flow, 2))
        return np.mean(by_x) / 2 + np.mean(by_y) / 2

    def smurf(flow):
        wide = a[:, :, :, 2:] - a[:, :, :, :-2], a[:, :, 2:] - a[:, :, :-2]
        edges = [np.exp(-np.mean(np.abs(150 * d), 1, keepdims=True)) for d in wide]
        robust = [np.sqrt(second(flow, axis) ** 2 + 1e-6) for axis in (3, 2)]
        return (np.mean(edges[0] * robust[0]) + np.mean(edges[1] * robust[1])) / 2

    def dfvo(flow):
        return edge_aware_normalised(np.sqrt(np.sum(flow**2, 1, keepdims=True)), a)

    for name, loss in (("smooth2_arflow", arflow), ("smooth2_smurf", smurf), ("smooth1_dfvo", dfvo)):
        out[f"out.{name}"], out[f"grad_{name}.flow"] = loss(flow), grad(loss)(flow)

    truth = t["in.flow_gt"]
    counts = (t["in.valid"] * (numpy.sqrt(numpy.sum(truth**2, 1)) < 400))[:, None]
    sequence = lambda *all: sum(0.8 ** (2 - i) * np.mean(counts * np.abs(f - truth)) for i, f in enumerate(all))
    predictions = [t[f"in.pred_{i}"] for i in range(3)]
    out["out.raft_sequence"] = sequence(*predictions)
    for i, value in enumerate(gradients(sequence, predictions)):
        out[f"grad_raft.pred_{i}"] = value
    return out


def competitors(t):
    names = "flow", "depth_t", "axisangle", "translation"
    inputs = [t[f"in.{name}"] for name in names]
    ks, mask, here = t["in.K"], t["in.mask"], numpy.stack([U, V])

    def rigid(depth, w, tau):
        def one(k, d, w, tau):
            return pixels(project(k, rays(k) * d, rotation(w[0]), tau[0])) - here

        return each(one, ks, depth, w, tau)

    rotational = rigid(inputs[1], inputs[2], 0 * inputs[3])
    # The public code comes back from sampling positions with W / 2 and H / 2 where (W - 1) / 2 and (H - 1) / 2 led there.
    stretched = (rotational + here) * numpy.array([W / (W - 1), H / (H - 1)]).reshape(2, 1, 1) - here
    q = numpy.stack([U - (W - 1) / 2, V - (H - 1) / 2])

    def radial(flow, depth, w, tau, turned):
        along = np.sum(q * (flow - turned), 1, keepdims=True)
        implied = -tau[:, 0, 2].reshape(-1, 1, 1, 1) * (np.sum(q**2, 0) + along) / (along + 1e-5)
        return np.abs(implied - depth) / (depth + 1e-5)

    def triangulated(flow, depth, w, tau):
        def one(k, f, d, w, tau):
            b, a = rays(k), tau[0]
            turned, s = np.tensordot(rotation(w[0]), b, 1), b[0] + f[0] / k[0, 0] + b[1] + f[1] / k[1, 1]
            implied = (a[0] + a[1] - a[2] * s) / (turned[2] * s - (turned[0] + turned[1]) + 1e-5)
            return np.abs(implied - d) / (d + 1e-5)

        return each(one, ks, flow, depth, w, tau)

    def gated(error):
        kept = constant(error) < 2
        return np.sum(np.where(kept, error, 0.0)) / kept.sum()

    cross = lambda flow, *motion: np.sum(np.abs(rigid(*motion) - flow) * mask) / (np.sum(mask) + 1e-3)
    out = {
        "out.rigid_flow": rigid(*inputs[1:]),
        "out.rot_flow": rotational,
        "out.rot_flow_repo": stretched,
        "out.cgdc_v2_ratio": np.minimum(radial(*inputs, rotational), 1e6),
        "out.cgdc_v2_ratio_repo": np.minimum(radial(*inputs, stretched), 1e6),
    }
    for name, loss in (
        ("cross_task", cross),
        ("cgdc_v2", lambda *a: gated(radial(*a, rotational))),
        ("cgdc_v2_repo", lambda *a: gated(radial(*a, stretched))),
        ("cgdc_v1_corrected", lambda *a: gated(triangulated(*a))),
    ):
        out[f"out.{name}"] = loss(*inputs)
        for leaf, value in zip(names, gradients(loss, inputs)):
            out[f"grad_{name}.{leaf}"] = value
    return out


class Pair:
    """Both aligned flows of one pair, and the four losses. `frame` says which translation a is split."""

    def __init__(self, k, flow, depth_t, at_source, r, tau, mask, frame):
        a = r.T @ tau if frame == "target" else tau
        fu, fv, u0, v0 = k[0, 0], k[1, 1], k[0, 2], k[1, 2]
        x = np.stack([(U + flow[0] - u0) / fu, (V + flow[1] - v0) / fv, np.ones((H, W))]) * at_source
        y = np.tensordot(r.T, x, 1)
        self.z_pla, self.z_axi = y[2] - a[2], y[2]
        project = lambda p: np.stack([fu * p[0] / p[2] + u0 - U, fv * p[1] / p[2] + v0 - V])
        self.f_pla = project(np.stack([y[0], y[1], self.z_pla]))
        self.f_axi = project(np.stack([y[0] - a[0], y[1] - a[1], self.z_axi]))
        self.q = numpy.stack([U - u0, V - v0])
        self.a, self.focal, self.z, self.mask = a, (fu, fv), depth_t[0], mask > 0
        self.base = self.mask & (at_source > Z_MIN) & (self.z_pla > Z_MIN) & (self.z_axi > Z_MIN)

    def literal(self):
        m, f, g, q = self.mask, self.f_pla, self.f_axi, self.q
        arc = lambda dot, size: np.arccos(np.where(m, np.clip(dot / np.where(m, size, 1.0), -1, 1), 0.5))
        length = lambda x: root(np.sum(x**2, 0))
        theta = arc(f[0], length(f))
        l_pla = mean(m, (theta - mean(m, theta)) ** 2)
        axial = arc(np.sum(g * q, 0), length(g) * length(q))
        l_axi = mean(m, axial)
        along = np.sum(g * q, 0)
        self.parts = {"theta_pla": theta * m, "theta_axi": axial * m}
        safe = lambda x: np.where(m, x, 1.0)
        ratios = [self.focal[0] / safe(f[0]), self.focal[1] / safe(f[1]), -(along + np.sum(q**2, 0)) / safe(along)]
        terms = []
        for axis, rho, a in zip("xyz", ratios, self.a):
            self.parts[f"rho_{axis}"] = rho * m
            rho = safe(rho)
            terms.append(self.both(axis, mean(m, np.abs(rho * a - self.z) / self.z), mean(m, self.z / rho), a, np.abs(a)))
        return l_pla, l_axi, terms[0] + terms[1], terms[2]

    def both(self, axis, pixel, recovered, a, divisor):
        """A + C along an axis, from A, the recovered component, the true one and what C is divided by."""
        aggregate = np.abs(recovered - a) / divisor
        self.parts |= {f"A_{axis}": pixel, f"rec_{axis}": recovered, f"C_{axis}": aggregate}
        return pixel + aggregate

    def robust(self, form):
        m, f, g, q, a, z = self.base, self.f_pla, self.f_axi, self.q, self.a, self.z
        radius = root(np.sum(q**2, 0))
        keep = lambda mask, x, other: np.where(mask, x, other)
        m_pla = m & (f[0] ** 2 + f[1] ** 2 > TAU_F**2)
        theta = np.arctan2(np.abs(keep(m_pla, f[1], 1.0)), keep(m_pla, f[0], 1.0))
        l_pla = mean(m_pla, (theta - mean(m_pla, theta)) ** 2)
        m_axi = m & (radius >= Q_MIN) & (g[0] ** 2 + g[1] ** 2 > TAU_F**2)
        along, across = np.sum(g * q, 0), q[0] * g[1] - q[1] * g[0]
        cosine = {"folded": np.abs(along), "signed": along, "pose_sign": along * (-1.0 if a[2] > 0 else 1.0)}[form]
        axial = np.arctan2(np.abs(keep(m_axi, across, 0.0)), keep(m_axi, cosine, 1.0))
        l_axi = mean(m_axi, axial)
        self.parts = {"theta_pla": theta * m_pla, "theta_axi": axial * m_axi, "m_pla": m_pla, "m_axi": m_axi}
        radial = along / np.where(radius > 0, radius, 1.0)
        scaled, found, terms = [], [], []
        for i in (0, 1):
            chosen = m & (np.abs(f[i]) > TAU_RHO)
            scaled.append((chosen, self.focal[i] * a[i] / keep(chosen, f[i], 1.0)))
            found.append((m, z * keep(m, f[i], 0.0) / self.focal[i]))
        off = m & (radius >= Q_MIN)
        chosen, whole = off & (np.abs(radial) > TAU_RHO), off & (radial + radius > TAU_RHO)
        scaled.append((chosen, -(along + radius**2) / keep(chosen, along, 1.0) * a[2]))
        found.append((whole, -z * keep(whole, along, 0.0) / keep(whole, along + radius**2, 1.0)))
        least = max(TAU_T, KAPPA * float(numpy.sqrt(numpy.sum(constant(a) ** 2))))
        for axis, (chosen, ratio), (used, recovered), a_k in zip("xyz", scaled, found, a):
            error = np.abs(keep(chosen, ratio, z) - z) / z
            gated = chosen & (error < GATE)
            self.parts[f"m_{axis}"] = gated
            divisor = np.maximum(np.abs(a_k), least)
            terms.append(self.both(axis, mean(gated, error), mean(used, recovered), a_k, divisor))
        return l_pla, l_axi, terms[0] + terms[1], terms[2]


def constant(x):
    """The numbers of x, without gradient."""
    while hasattr(x, "_value"):
        x = x._value
    return numpy.asarray(x)


def mean(mask, x):
    return np.sum(np.where(mask, x, 0.0)) / max(mask.sum(), 1)


TERMS = ["L_pla", "L_axi", "L_tan", "L_rad"]
LEAVES = ["flow", "depth_t", "depth_s", "axisangle", "translation"]


def rows(t, choices):
    """Losses, masks and gradients of the batch mean, for (row, frame, losses of a pair)."""
    out = {}
    for row, frame, losses in choices:

        def pairs(flow, depth_t, depth_s, w, tau):
            for n in range(len(flow)):
                at_source = sample(depth_s[n], U + flow[n, 0], V + flow[n, 1], "border")[0]
                mask = t["in.mask"][n] * in_view(constant(flow[n]))
                yield Pair(t["in.K"][n], flow[n], depth_t[n], at_source, rotation(w[n, 0]), tau[n, 0], mask, frame)

        inputs = [t[f"in.{leaf}"] for leaf in LEAVES]
        made = list(pairs(*inputs))
        found = np.array([losses(p) for p in made])
        for name in made[0].parts:
            out[f"out.{row}.{name}"] = np.stack([p.parts[name] for p in made])
        for name in ("f_pla", "f_axi", "z_pla", "z_axi"):
            out[f"out.{row}.{name}"] = np.stack([getattr(p, name) for p in made])
        out[f"out.{row}.t_used"] = np.stack([p.a for p in made])
        out[f"out.{row}.m_base"] = np.stack([p.base for p in made])
        for i, term in enumerate(TERMS):
            out[f"out.{row}.{term}"] = found[:, i]
            out[f"out.{row}.{term}_batch"] = found[:, i].mean()
            loss = lambda *a: sum(losses(p)[i] for p in pairs(*a)) / len(made)
            for leaf, value in zip(LEAVES, gradients(loss, inputs)):
                out[f"grad.{row}.{term}.{leaf}"] = value
        out[f"out.{row}.stage3"] = np.dot([0.05, 0.05, 0.1, 0.1], found.mean(0))
        counts = numpy.array([p.mask.sum() for p in made])
        out[f"out.{row}.L_pla_unbiased"] = found[:, 0] * counts / (counts - 1)
        ends = t["in.flow"] + numpy.stack([U, V])
        at_source = each(lambda d, p: sample(d, p[0], p[1], "border"), t["in.depth_s"], ends)
        directions = [((p - k[:2, 2:, None]) / numpy.diag(k)[:2, None, None]) for p, k in zip(ends, t["in.K"])]
        out["out.D_st"], out[f"out.{row}.p_s"] = at_source, ends
        out[f"out.{row}.P_s"] = at_source * np.stack([np.concatenate([d, np.ones((1, H, W))]) for d in directions])
    return out


def printed_is_finite(t):
    """Whether each printed loss without any guard is finite on the mask, image by image."""
    finite = []
    for n in range(2):
        at_source = sample(t["in.depth_s"][n], U + t["in.flow"][n, 0], V + t["in.flow"][n, 1], "border")[0]
        r, mask = rotation(t["in.axisangle"][n, 0]), t["in.mask"][n] > 0
        p = Pair(t["in.K"][n], t["in.flow"][n], t["in.depth_t"][n], at_source, r, t["in.translation"][n, 0], mask, "literal")
        f, g, q = p.f_pla, p.f_axi, p.q
        length = lambda x: numpy.sqrt(numpy.sum(x**2, 0))
        along = numpy.sum(g * q, 0)
        with numpy.errstate(all="ignore"):
            angles = numpy.arccos(f[0] / length(f)), numpy.arccos(along / (length(g) * length(q)))
            ratios = 1 / f[0] + 1 / f[1], (along + numpy.sum(q**2, 0)) / along
        finite.append([numpy.isfinite(x[mask]).all() for x in (*angles, *ratios)])
    return numpy.array(finite)


def dimode_literal(t):
    return rows(t, [("literal", "literal", Pair.literal), ("target", "target", Pair.literal)])


def dimode_robust(t):
    forms = [("literal", "signed"), ("target", "folded"), ("target", "pose_sign")]
    out = rows(t, [(f"{frame}_{form}", frame, lambda p, form=form: p.robust(form)) for frame, form in forms])
    return out | {"out.literal_finite": printed_is_finite(t)}


def dimode_exact(t):
    out = {}
    for source in ("next", "prev"):
        at = lambda name: t[f"in.{source}.{name}"]
        for row, frame, losses in (
            ("literal", "literal", Pair.literal),
            ("target", "target", Pair.literal),
            ("robust", "target", lambda p: p.robust("folded")),
        ):
            inputs = at("flow"), at("depth_t"), at("depth_s_at_ps")[:, 0], at("R"), at("t"), at("mask")
            made = [Pair(*one, frame) for one in zip(t["in.K"], *inputs)]
            values = [losses(p) for p in made]
            out[f"out.{source}.{row}.recovered"] = np.array([[p.parts[f"rec_{axis}"] for axis in "xyz"] for p in made])
            out[f"out.{source}.{row}.f_pla"] = np.stack([p.f_pla for p in made])
            out[f"out.{source}.{row}.f_axi"] = np.stack([p.f_axi for p in made])
            out[f"out.{source}.t_target_frame"] = np.stack([p.a for p in made])
            for i, term in enumerate(TERMS):
                out[f"out.{source}.{row}.{term}"] = np.array([v[i] for v in values])
    return out


FILES = [
    pose, disp_depth, warp, ssim, photometric, min_reproj, smoothness, monodepth_total, sc_geometry, rectify, normals, lsr,
    pseudo_guided, flow_masks, dynamo, flow_losses, competitors,
    dimode_literal, dimode_robust, dimode_exact,
]  # fmt: skip


def distance(name, made, stored, whole):
    """Largest difference as a share of the largest magnitude. Results near 0 count absolutely, below a hundredth."""
    difference = numpy.abs(numpy.asarray(made, float) - stored)
    if name.endswith(".flow"):
        difference[whole] = 0.0
    return difference.max() / max(numpy.abs(stored).max(), 1e-2 if name.startswith("out.") else 1e-6)


def main():
    warnings.filterwarnings("ignore", message="Output seems independent of input")
    failed = False
    for make in FILES:
        stored = read(make.__name__)
        # At flows that end on a whole row or column the sampled depth has a kink, and either derivative is right.
        flow = stored.get("in.flow", numpy.zeros((1, 1)))
        whole = numpy.broadcast_to((numpy.abs(flow - numpy.round(flow)) < 1e-9).any(1, keepdims=True), flow.shape)
        far = {k: distance(k, v, stored[k], whole) for k, v in make(stored).items() if k in stored}
        worst = max(far, key=far.get)
        failed |= far[worst] > LIMIT
        print(f"{make.__name__}: {len(far)} tensors, furthest {worst} {far[worst]:.1e}", flush=True)
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
