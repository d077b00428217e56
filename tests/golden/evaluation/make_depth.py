"""Writes depth.json: the depth metrics of the scenes in depth.safetensors, as a second program gives them.

The program below is NumPy in double precision, independent of the Rust code, and follows the evaluation of Monodepth2:
the disparity is resized to the size of the ground truth and inverted, pixels are chosen by the bounds (compared in single
precision) and the crop, the prediction is scaled by the ratio of the medians and clamped to the bounds, seven means are
taken. `python3 make_depth.py`, in this folder, rewrites the file.
"""

import json

import numpy as np

TRUTH = (64, 208)
SCENES = ["small_0", "small_3", "small_4"]
PROTOCOLS = {
    "garg_median_80": {},
    "garg_lower_median_80": {"median": lambda x: np.sort(x)[(len(x) - 1) // 2]},
    "garg_median_80_no_clamp": {"clamp": False},
    "median_200": {"longest": 200, "crop": (0, 1, 0, 1)},
}
RESIZED = {
    "small_0": (TRUTH, [(0, 0), (0, 207), (63, 0), (63, 207), (32, 104), (21, 41), (7, 13)]),
    "small_0_down": ((13, 37), [(0, 0), (12, 36), (6, 18)]),
}
GARG = (0.40810811, 0.99189189, 0.03594771, 0.96405229)


def read(path):
    content = open(path, "rb").read()
    start = 8 + int.from_bytes(content[:8], "little")
    tensors = {}
    for name, entry in json.loads(content[8:start]).items():
        first, last = entry["data_offsets"]
        values = np.frombuffer(content[start + first : start + last], {"F32": "<f4", "I32": "<i4"}[entry["dtype"]])
        tensors[name] = values.reshape(entry["shape"])
    return tensors


def resize(image, size):
    """Bilinear, with half-pixel centres and clamped borders."""
    for axis, count in enumerate(size):
        have = image.shape[axis]
        x = np.clip((np.arange(count) + 0.5) * have / count - 0.5, 0, have - 1)
        low = x.astype(int)
        high = np.minimum(low + 1, have - 1)
        share = np.expand_dims(x - low, 1 - axis)
        image = image.take(low, axis) * (1 - share) + image.take(high, axis) * share
    return image


def evaluate(truth, depth, shortest=1e-3, longest=80, crop=GARG, median=np.median, clamp=True):
    rows, columns = truth.shape
    top, bottom = (int(part * rows) for part in crop[:2])
    left, right = (int(part * columns) for part in crop[2:])
    inside = np.zeros(truth.shape, bool)
    inside[top:bottom, left:right] = True
    valid = inside & (truth > np.float32(shortest)) & (truth < np.float32(longest))
    g, p = truth[valid].astype(float), depth[valid]
    ratio = median(g) / median(p)
    p = p * ratio
    below, above = int((p < shortest).sum()), int((p > longest).sum())
    if clamp:
        p = np.clip(p, shortest, longest)
    worse = np.maximum(g / p, p / g)
    return {
        "n_valid": int(valid.sum()),
        "ratio": ratio,
        "n_below_min": below,
        "n_above_max": above,
        "abs_rel": np.mean(np.abs(g - p) / g),
        "sq_rel": np.mean((g - p) ** 2 / g),
        "rmse": np.sqrt(np.mean((g - p) ** 2)),
        "rmse_log": np.sqrt(np.mean((np.log(g) - np.log(p)) ** 2)),
        "a1": np.mean(worse < 1.25),
        "a2": np.mean(worse < 1.25**2),
        "a3": np.mean(worse < 1.25**3),
    }


def rounded(value):
    return value if isinstance(value, int) else float(f"{value:.12g}")


def main():
    tensors = read("depth.safetensors")
    numbers = {name: {} for name in PROTOCOLS}
    for scene in SCENES:
        truth = np.zeros(TRUTH, np.float32)
        truth.flat[tensors[f"{scene}.gt_index"]] = tensors[f"{scene}.gt_depth"]
        depth = 1 / resize(tensors[f"{scene}.pred_disp"].astype(float), TRUTH)
        for name, choices in PROTOCOLS.items():
            numbers[name][scene] = {key: rounded(value) for key, value in evaluate(truth, depth, **choices).items()}
    numbers["resize"] = {}
    for name, (size, places) in RESIZED.items():
        resized = resize(tensors["small_0.pred_disp"].astype(float), size)
        values = [rounded(resized[place]) for place in places]
        numbers["resize"][name] = {"out": size, "rows_cols": places, "values": values}
    with open("depth.json", "w") as f:
        json.dump(numbers, f, indent=1)
        f.write("\n")


if __name__ == "__main__":
    main()
