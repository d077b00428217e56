"""Writes odometry_{truth,estimate}.txt and odometry.json: an invented drive and the numbers a second program gives for it.

The program below is NumPy, independent of the Rust code: general 4x4 inverse (LAPACK), arccos of the clamped trace,
alignment by LAPACK's SVD. `python3 make_odometry.py` rewrites the three files; `python3 make_odometry.py TRUTH ESTIMATE`
prints the numbers for any other pair of KITTI files (12 numbers a line, or 13 with the frame index first).
"""

import json
import sys

import numpy as np

LENGTHS = [100, 200, 300, 400, 500, 600, 700, 800]


def read(path):
    poses = {}
    for row, line in enumerate(open(path)):
        values = [float(word) for word in line.split()]
        index = row if len(values) == 12 else int(values[0])
        pose = np.eye(4)
        pose[:3] = np.array(values[-12:]).reshape(3, 4)
        poses[index] = pose
    return poses


def similarity(x, y, with_scale):
    mx, my = x.mean(0), y.mean(0)
    u, d, vt = np.linalg.svd((y - my).T @ (x - mx) / len(x))
    s = np.ones(3)
    if np.linalg.det(u) * np.linalg.det(vt) < 0:
        s[2] = -1
    r = u @ np.diag(s) @ vt
    c = (d * s).sum() / ((x - mx) ** 2).sum() * len(x) if with_scale else 1.0
    return r, my - c * r @ mx, c


def angle(m):
    return np.arccos(np.clip((np.trace(m[:3, :3]) - 1) / 2, -1, 1))


def evaluate(truth, estimate, alignment):
    inv = np.linalg.inv
    first = min(estimate)
    g0, p0 = inv(truth[first]), inv(estimate[first])
    g = {i: g0 @ truth[i] for i in sorted(truth)}
    p = {i: p0 @ estimate[i] for i in sorted(estimate)}
    x = np.array([p[i][:3, 3] for i in p])
    y = np.array([g[i][:3, 3] for i in p])
    scale, motion = 1.0, np.eye(4)
    if alignment == "scale":
        scale = (x * y).sum() / (x * x).sum()
    elif alignment != "none":
        r, t, c = similarity(x, y, alignment != "se3")
        scale = c
        if alignment != "scale_7dof":
            motion[:3, :3], motion[:3, 3] = r, t
    for i in p:
        p[i] = p[i].copy()
        p[i][:3, 3] *= scale
        p[i] = motion @ p[i]
    ids = sorted(g)
    d = [0.0]
    for a, b in zip(ids, ids[1:]):
        d.append(d[-1] + np.linalg.norm(g[b][:3, 3] - g[a][:3, 3]))
    rows = []
    for k in range(0, len(ids), 10):
        for length in LENGTHS:
            last = next((m for m in range(k, len(ids)) if d[m] > d[k] + length), None)
            if last is None or ids[k] not in p or ids[last] not in p:
                continue
            a, b = ids[k], ids[last]
            e = inv(inv(p[a]) @ p[b]) @ (inv(g[a]) @ g[b])
            rows.append((length, np.linalg.norm(e[:3, 3]) / length, angle(e) / length))
    pairs = [i for i in p if i + 1 in p]
    rel = [inv(inv(g[i]) @ g[i + 1]) @ (inv(p[i]) @ p[i + 1]) for i in pairs]
    return {
        "e_t_percent": 100 * np.mean([r[1] for r in rows]) if rows else None,
        "e_r_deg_per_100m": 100 * np.degrees(np.mean([r[2] for r in rows])) if rows else None,
        "segments": len(rows),
        "per_length": [
            [n, sum(r[0] == n for r in rows)]
            + [float(np.mean([f * r[k] for r in rows if r[0] == n])) for k, f in ((1, 100), (2, 18000 / np.pi))]
            for n in LENGTHS
            if any(r[0] == n for r in rows)
        ],
        "ate_m": float(np.sqrt(np.mean([((g[i][:3, 3] - p[i][:3, 3]) ** 2).sum() for i in p]))),
        "rpe_translation_m": float(np.mean([np.linalg.norm(e[:3, 3]) for e in rel])),
        "rpe_rotation_deg": float(np.degrees(np.mean([angle(e) for e in rel]))),
        "rpe_pairs": len(pairs),
        "scale": float(scale),
    }


def rotation(w):
    t = np.linalg.norm(w)
    k = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    if t < 1e-12:
        return np.eye(3) + k
    return np.eye(3) + np.sin(t) / t * k + (1 - np.cos(t)) / t**2 * k @ k


def invent(count):
    rng = np.random.default_rng(20)
    truth, estimate = [np.eye(4)], [np.eye(4)]
    for i in range(count - 1):
        turn = np.array([0.002 * np.sin(i / 7), 0.02 * np.sin(i / 31) + 0.006, 0.001 * np.cos(i / 11)])
        step = np.array([0.02 * np.sin(i / 5), 0.01 * np.cos(i / 9), 0.9 + 0.3 * np.sin(i / 40)])
        for poses, w, t in (
            (truth, turn, step),
            (estimate, turn + rng.normal(0, 6e-4, 3), (step + rng.normal(0, 0.02, 3)) * 0.07 * (1 + i / 4000)),
        ):
            motion = np.eye(4)
            motion[:3, :3], motion[:3, 3] = rotation(w), t
            poses.append(poses[-1] @ motion)
    tilt = np.eye(4)
    tilt[:3, :3], tilt[:3, 3] = rotation(np.array([0.3, -0.2, 0.1])), [2, 1, -3]
    return truth, [tilt @ pose for pose in estimate]


def main():
    names = ["none", "scale", "se3", "sim3", "scale_7dof"]
    if len(sys.argv) == 3:
        t, e = read(sys.argv[1]), read(sys.argv[2])
        print(json.dumps({name: evaluate(t, e, name) for name in names}))
        return
    truth, estimate = invent(420)
    row = lambda pose: " ".join(f"{v:.8e}" for v in pose[:3].ravel())
    with open("odometry_truth.txt", "w") as f:
        f.writelines(row(pose) + "\n" for pose in truth)
    with open("odometry_estimate.txt", "w") as f:  # starts at frame 3, has a gap
        f.writelines(f"{i} {row(p)}\n" for i, p in enumerate(estimate) if i >= 3 and not 200 <= i < 212)
    t, e = read("odometry_truth.txt"), read("odometry_estimate.txt")
    with open("odometry.json", "w") as f:
        json.dump({name: evaluate(t, e, name) for name in names}, f, indent=1)


if __name__ == "__main__":
    main()
