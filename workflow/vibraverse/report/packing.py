"""Arrays in scripts: quantised, compressed and in base64, as ``page/unpack.js`` reads them.

A page that is opened from disk may read no files but scripts, so data come as calls of functions of the page.
"""

from __future__ import annotations

import base64
import json
import zlib

import numpy as np


def packed(array: np.ndarray, steps=(1.0,)) -> dict:
    """Return an array as a field of a script; its values are the stored ones times their step.

    ``steps`` holds one for all values, or one for each row along the first axis.

    The bytes of all values stand in planes, the lowest byte of each first. Neighbours resemble one another, so that
    compresses best.
    """
    stored = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    planes = stored.reshape(-1).view(np.uint8).reshape(-1, stored.itemsize).T
    return {
        "type": array.dtype.name,
        "shape": list(array.shape),
        "steps": list(steps),
        "data": base64.b64encode(zlib.compress(planes.tobytes(), 9)).decode("ascii"),
    }


def quantised(values: np.ndarray, largest: int) -> tuple[np.ndarray, list[float]]:
    """Return values as 16-bit integers from ``-largest`` to ``largest``, and the step of each row."""
    rows = values.reshape(len(values), -1)
    steps = np.abs(rows).max(axis=1, initial=0.0) / largest
    steps[steps == 0] = 1.0
    return np.round(rows / steps[:, None]).astype(np.int16).reshape(values.shape), steps.tolist()


def unpacked(field: dict) -> np.ndarray:
    """Return the values of a field of a script as float64."""
    dtype = np.dtype(field["type"]).newbyteorder("<")
    planes = np.frombuffer(zlib.decompress(base64.b64decode(field["data"])), np.uint8)
    stored = np.ascontiguousarray(planes.reshape(dtype.itemsize, -1).T).view(dtype)
    rows = stored.reshape(len(field["steps"]), -1).astype(np.float64) * np.reshape(field["steps"], (-1, 1))
    return rows.reshape(field["shape"])


def call(function: str, *arguments) -> str:
    """Return a script that calls a function of the page; the text holds ASCII alone and cannot end a script early."""
    said = ", ".join(json.dumps(one, separators=(",", ":")).replace("</", "<\\/") for one in arguments)
    return f"{function}({said});\n"
