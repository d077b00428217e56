"""Makes the numbers in *.f64.safetensors anew from the inputs in the same files, and compares.

A second program in NumPy with the package `autograd` (reverse-mode gradients), independent of the Rust code and of PyTorch,
which made the stored numbers. `pip install numpy autograd`, then `python3 check_losses.py` in this folder: one line for each
file with the largest distance, relative to the largest magnitude of the tensor; ends with 1 when one is above 1e-8.
Every formula below is the definition of the tensors it returns. Tensors that it does not return are read by no test.
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
        "out.T": each(lambda *a: transforms(*a)[0], *inputs),
        "out.T_inv": each(lambda *a: transforms(*a)[1], *inputs),
        "grad.axisangle": by_w,
        "grad.translation": by_tau,
    }


def warp(t):
    def project(k, depth, w, tau):
        """K (R D K^-1 p + t), and its first two rows divided by the third + 1e-7."""
        points = np.tensordot(rotation(w[0]), rays(k) * depth, 1) + tau[0].reshape(3, 1, 1)
        y = np.tensordot(k, points, 1)
        return np.concatenate([y[:2] / (y[2:] + 1e-7), y[2:]])

    def warped(image, depth, w, tau, padding):
        one = lambda k, i, d, w, tau: sample(i, *project(k, d, w, tau)[:2], padding)
        return each(one, t["in.K"], image, depth, w, tau)

    inputs = t["in.image"], t["in.depth"], t["in.axisangle"], t["in.translation"]
    projected = each(project, t["in.K"], *inputs[1:])
    out = {"out.pix": projected[:, :2], "out.computed_depth": projected[:, 2:]}
    for padding in ("border", "zeros"):
        out[f"out.warped_{padding}_ac1"] = warped(*inputs, padding)
    loss = lambda *a: np.sum(warped(*a, "border") * t["in.w"])
    for name, value in zip(("image", "depth", "axisangle", "translation"), gradients(loss, inputs)):
        out[f"grad_border_ac1.{name}"] = value
    return out


# Images.


def box(x, k):
    """Mean over k x k pixels of (N,C,H,W), the border mirrored without repeating its pixels."""
    rows, columns = (numpy.pad(numpy.arange(n), k // 2, mode="reflect") for n in (H, W))
    x = sum(x[:, :, rows[i : i + H]] for i in range(k)) / k
    return sum(x[:, :, :, columns[i : i + W]] for i in range(k)) / k


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
    for k in (3, 7):
        out[f"out.dissim{k}"] = dissimilarity(t["in.x"], t["in.y"], k)
        loss = lambda x, y: np.sum(dissimilarity(x, y, k) * t[f"in.w_dissim{k}"])
        out[f"grad_dissim{k}.x"], out[f"grad_dissim{k}.y"] = gradients(loss, (t["in.x"], t["in.y"]))
    return out


def photometric(t):
    inputs = t["in.pred"], t["in.target"]
    by_pred, by_target = gradients(lambda *a: np.mean(photo(*a)), inputs)
    error = photo(*inputs)
    return {"out.photo": error, "out.loss": np.mean(error), "grad.pred": by_pred, "grad.target": by_target}


def min_reproj(t):
    target = t["in.target"]
    unmoved = [photo(t[f"in.src_{s}"], target) for s in ("prev", "next")]
    lowest = lambda a, b, more: np.min(np.concatenate([*more, photo(a, target), photo(b, target)], 1), 1)
    inputs = t["in.warped_prev"], t["in.warped_next"]
    out = {"out.min": lowest(*inputs, unmoved)}
    for more, value, prefix in ((unmoved, "loss", "grad"), ([], "loss_no_automask", "grad_no_automask")):
        loss = lambda a, b: np.mean(lowest(a, b, more))
        out[f"out.{value}"] = loss(*inputs)
        out[f"{prefix}.warped_prev"], out[f"{prefix}.warped_next"] = gradients(loss, inputs)
    return out


def smoothness(t):
    def raw(d, image):
        step = lambda x, axis: np.abs(np.diff(x, axis=axis))
        edge = lambda axis: np.exp(-np.mean(step(image, axis), 1, keepdims=True))
        return np.mean(step(d, 3) * edge(3)) + np.mean(step(d, 2) * edge(2))

    normalised = lambda d, image: raw(d / (np.mean(d, (2, 3), keepdims=True) + 1e-7), image)
    out, inputs = {}, (t["in.disp"], t["in.image"])
    for name, loss in (("raw", raw), ("normalised", normalised)):
        out[f"out.{name}"] = loss(*inputs)
        out[f"grad_{name}.disp"], out[f"grad_{name}.image"] = gradients(loss, inputs)
    return out


def normals(t):
    def one(k, depth):
        points = rays(k) * depth
        padded = lambda x: x[:, numpy.arange(-1, H + 1).clip(0, H - 1)][:, :, numpy.arange(-1, W + 1).clip(0, W - 1)]
        p = padded(points)
        rows, columns = p[:, :-2] + 2 * p[:, 1:-1] + p[:, 2:], p[:, :, :-2] + 2 * p[:, :, 1:-1] + p[:, :, 2:]
        du, dv = (rows[:, :, 2:] - rows[:, :, :-2]) / 8, (columns[:, 2:] - columns[:, :-2]) / 8
        n = np.stack([du[i] * dv[j] - du[j] * dv[i] for i, j in ((1, 2), (2, 0), (0, 1))])
        return n / np.maximum(root(np.sum(n**2, 0)), 1e-12)

    loss = lambda depth: np.sum(each(one, t["in.K"], depth) * t["in.w"])
    return {"out.normals": each(one, t["in.K"], t["in.depth"]), "grad.depth": grad(loss)(t["in.depth"])}


def pseudo_guided(t):
    def mean(x, r=4):
        window = lambda i, n: slice(max(i - r, 0), min(i + r, n - 1) + 1)
        return numpy.array([[x[window(v, H), window(u, W)].mean() for u in range(W)] for v in range(H)])

    def one(depth, image):
        guide = numpy.tensordot([0.2989, 0.5870, 0.1140], image, 1)
        y = 1 / depth[0]
        y = y / (y.mean() + 1e-7)
        a = (mean(guide * y) - mean(guide) * mean(y)) / (mean(guide**2) - mean(guide) ** 2 + 1e-3)
        b = mean(y) - a * mean(guide)
        return (1 / numpy.maximum(mean(a) * guide + mean(b), 1e-3))[None]

    return {"out.pseudo_depth": each(one, t["in.depth"], t["in.image"])}


# Flows.


def in_view(flow):
    x, y = U + flow[0], V + flow[1]
    return (x >= 0) & (x <= W - 1) & (y >= 0) & (y <= H - 1)


def flow_masks(t):
    forward, rigid = t["in.flow_fw"], t["in.rigid_flow"]
    back = each(lambda f, b: sample(b, U + f[0], V + f[1], "zeros"), forward, t["in.flow_bw"])
    square = lambda x: numpy.sum(x**2, 1, keepdims=True)
    moved = square(rigid - forward)[:, 0]
    return {
        "out.bw_warped": back,
        "out.occluded_fb": square(forward + back) > 0.01 * (square(forward) + square(back)) + 0.5,
        "out.in_view": each(in_view, forward)[:, None],
        "out.static_px_per_image": moved < moved.mean((1, 2), keepdims=True),
    }


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
        l_axi = mean(m, arc(np.sum(g * q, 0), length(g) * length(q)))
        along = np.sum(g * q, 0)
        safe = lambda x: np.where(m, x, 1.0)
        ratios = [self.focal[0] / safe(f[0]), self.focal[1] / safe(f[1]), -(along + np.sum(q**2, 0)) / safe(along)]
        terms = []
        for rho, a in zip(ratios, self.a):
            rho = safe(rho)
            terms.append(mean(m, np.abs(rho * a - self.z) / self.z) + np.abs((mean(m, self.z / rho) - a) / a))
        return l_pla, l_axi, terms[0] + terms[1], terms[2]

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
        l_axi = mean(m_axi, np.arctan2(np.abs(keep(m_axi, across, 0.0)), keep(m_axi, cosine, 1.0)))
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
        for (chosen, ratio), (used, recovered), a_k in zip(scaled, found, a):
            error = np.abs(keep(chosen, ratio, z) - z) / z
            gated = chosen & (error < GATE)
            terms.append(mean(gated, error) + np.abs(mean(used, recovered) - a_k) / np.maximum(np.abs(a_k), least))
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
        for name in ("f_pla", "f_axi", "z_pla", "z_axi"):
            out[f"out.{row}.{name}"] = np.stack([getattr(p, name) for p in made])
        out[f"out.{row}.t_used"] = np.stack([p.a for p in made])
        out[f"out.{row}.m_base"] = np.stack([p.base for p in made])
        for i, term in enumerate(TERMS):
            out[f"out.{row}.{term}"] = np.array([losses(p)[i] for p in made])
            loss = lambda *a: sum(losses(p)[i] for p in pairs(*a)) / len(made)
            for leaf, value in zip(LEAVES, gradients(loss, inputs)):
                out[f"grad.{row}.{term}.{leaf}"] = value
    return out


def dimode_literal(t):
    return rows(t, [("literal", "literal", Pair.literal), ("target", "target", Pair.literal)])


def dimode_robust(t):
    forms = [("literal", "signed"), ("target", "folded"), ("target", "pose_sign")]
    return rows(t, [(f"{frame}_{form}", frame, lambda p, form=form: p.robust(form)) for frame, form in forms])


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
            values = [losses(Pair(*one, frame)) for one in zip(t["in.K"], *inputs)]
            for i, term in enumerate(TERMS):
                out[f"out.{source}.{row}.{term}"] = np.array([v[i] for v in values])
    return out


FILES = [
    pose, warp, ssim, photometric, min_reproj, smoothness, normals, pseudo_guided, flow_masks,
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
