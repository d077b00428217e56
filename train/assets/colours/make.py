"""Writes magma.txt and turbo.txt: 256 colours each, one `rrggbb` a line, rounded from the published tables.

Needs matplotlib, which carries both tables: python make.py
"""

from matplotlib._cm_listed import _magma_data, _turbo_data

ORIGIN = {
    "magma": [
        "magma, by Stefan van der Walt and Nathaniel Smith, published with matplotlib.",
        "Dedicated to the public domain: SPDX-License-Identifier: CC0-1.0",
    ],
    "turbo": [
        "turbo, by Anton Mikhailov. Copyright 2019 Google LLC.",
        "SPDX-License-Identifier: Apache-2.0",
        "Changed: each number is rounded to eight bits.",
    ],
}

for name, table in [("magma", _magma_data), ("turbo", _turbo_data)]:
    with open(f"{name}.txt", "w", encoding="ascii") as file:
        file.writelines(f"# {line}\n" for line in ORIGIN[name])
        for colour in table:
            file.write("".join(f"{int(255 * c + 0.5):02x}" for c in colour) + "\n")
