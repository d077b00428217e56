#!/usr/bin/env python3
"""Answers requests of `compare`: one JSON object a line on stdin, one JSON line each on stdout.

    {"do": "hello"}
        -> {"torch": version, "tuned": whether the allocator keeps memory}
    {"do": "build", "topic": "conv", "case": {...}, "variant": {...}, "key": text, "threads": 2, "dir": folder}
        -> {"values": {...}}     inputs and results are written as raw f32 files
    {"do": "time", "key": text, "what": "forward", "threads": 2, "seconds": 0.3}
        -> {"samples": [milliseconds, ...]}
    {"do": "forget"}
        -> {}                    drops everything that was built

A request that fails is answered by {"error": text}. Between requests the process only waits for input. Threads of the OpenMP
run-time spin for some milliseconds after their last loop and sleep then; `compare` waits for that before its own turn.
"""

import importlib
import json
import os
import sys
import time
import traceback

import torch

from store import Store

TOPICS = ("conv", "pieces", "loss_core", "losses", "networks", "encoder", "step", "adam")
# Repetitions of one request at least and at most, after two that warm up.
FEWEST, MOST = 3, 300


def build(request):
    """Builds a case: a dictionary of functions without arguments by name, and values that have been computed."""
    topic = request["topic"]
    if topic not in TOPICS:
        raise ValueError(f"no topic '{topic}'; there are {', '.join(TOPICS)}")
    variant = request["variant"]
    torch.set_num_threads(request["threads"])
    store = Store(request["dir"], request["case"]["name"], request["key"])
    return importlib.import_module(topic).build(request["case"], variant, store)


def measure(run, seconds):
    """Milliseconds of each repetition."""
    for _ in range(2):
        run()
    samples, start = [], time.perf_counter()
    while len(samples) < FEWEST or (time.perf_counter() - start < seconds and len(samples) < MOST):
        before = time.perf_counter()
        run()
        samples.append(1e3 * (time.perf_counter() - before))
    return samples


def answer(request, state):
    """The answer to one request."""
    what = request["do"]
    if what == "hello":
        return {"torch": torch.__version__, "tuned": "MALLOC_TRIM_THRESHOLD_" in os.environ}
    if what == "build":
        state[request["key"]], values = build(request)
        return {"values": values}
    if what == "time":
        torch.set_num_threads(request["threads"])
        return {"samples": measure(state[request["key"]][request["what"]], request["seconds"])}
    if what == "forget":
        state.clear()
        return {}
    raise ValueError(f"no request '{what}'")


def main():
    """Serves until stdin ends."""
    # Libraries that print must not disturb the answers.
    out, sys.stdout = sys.stdout, sys.stderr
    state = {}
    for line in sys.stdin:
        try:
            reply = answer(json.loads(line), state)
        except Exception as error:  # pylint: disable=broad-except
            traceback.print_exc()
            reply = {"error": f"{type(error).__name__}: {error}"[:400]}
        print(json.dumps(reply), file=out, flush=True)


if __name__ == "__main__":
    main()
