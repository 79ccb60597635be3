"""A caustic by Dr.Jit: what people would write who had no simulator of caustics. A process of its own, see ``peer.py``.

Jittered photons, a gather of 16 spline coefficients, refraction at both faces, and each photon into one pixel (``box``)
or into 2 x 2 of them (``bilinear``, which has a gradient). Needs Dr.Jit and NumPy, and nothing of this project. Takes
commands as lines of JSON on standard input, and answers with one line each.
"""

import json
import sys
import time
from typing import Any

import drjit as dr
import numpy as np


class Tracer:
    """Photons of one scene on one backend.

    Args:
        task: numbers of the scene, see ``peer.task_of``.
        backend: ``llvm`` or ``cuda``.
    """

    def __init__(self, task: dict[str, Any], backend: str):
        self.task = task
        self.types: Any = __import__(f"drjit.{backend}.ad", fromlist=["ad"])
        self.coefficients = self.types.Float(np.load(task["coefficients"]).astype(np.float32).ravel())
        weights = np.random.default_rng(0).standard_normal(task["channels"] * task["pixels"] ** 2)
        self.weights = self.types.Float(weights.astype(np.float32))

    def surface(self, coefficients: Any, x: Any, y: Any) -> tuple[Any, Any, Any]:
        """Height [m] and slopes of the cubic B-spline at (x, y) [m] from its coefficients [n + 4, n + 4]."""
        n, pitch = self.task["samples"], self.task["pitch_m"]
        u, v = x / pitch + (n - 1) / 2, y / pitch + (n - 1) / 2
        # By comparison: older LLVM libraries have no minimum of vectors.
        column, row = (dr.select(at < n, dr.floor(at), n - 1) for at in (u, v))
        along_x, along_y = spline(u - column), spline(v - row)
        first = self.types.UInt32((row + 1) * (n + 4) + column + 1)
        height = slope_x = slope_y = 0
        for k in range(4):
            value = slope = 0
            for i in range(4):
                c = dr.gather(self.types.Float, coefficients, first + (k * (n + 4) + i))
                value = dr.fma(along_x[0][i], c, value)
                slope = dr.fma(along_x[1][i], c, slope)
            height = dr.fma(along_y[0][k], value, height)
            slope_x = dr.fma(along_y[0][k], slope, slope_x)
            slope_y = dr.fma(along_y[1][k], value, slope_y)
        return height, slope_x / pitch, slope_y / pitch

    def image(self, coefficients: Any, side: int, splat: str) -> Any:
        """Irradiance, flat [channels * pixels * pixels], of side x side photons per wavelength."""
        task, m = self.task, self.task["pixels"]
        length, pixel = task["plate_m"], task["plate_m"] / m
        index = dr.arange(self.types.UInt32, side * side)
        generator = self.types.PCG32(size=side * side)
        x = (self.types.Float(index % side) + generator.next_float32()) * (length / side) - length / 2
        y = (self.types.Float(index // side) + generator.next_float32()) * (length / side) - length / 2
        h, h_x, h_y = self.surface(coefficients, x, y)
        found = dr.zeros(self.types.Float, task["channels"] * m * m)
        slope2 = h_x * h_x + h_y * h_y
        for channel, (index_glass, index_out) in enumerate(zip(task["glass"], task["outside"], strict=True)):
            # --- Snell's law for light along -z: shift against the slope, inside the glass and behind it
            eta, ratio = 1 / index_glass, index_glass / index_out
            root = dr.sqrt(eta * eta + (1 - eta * eta) * (1 + slope2))
            shift = (task["base_m"] + h) * ((1 - eta * eta) / (1 + eta * root))
            sine = ratio * (1 - eta * eta) / (root + eta)
            cosine2 = 1 - sine * sine * slope2
            shift = shift + task["gap_m"] * sine * dr.rsqrt(dr.select(cosine2 > 1e-6, cosine2, 1e-6))
            column = (x + shift * h_x - task["window_m"][0]) / pixel
            row = (y + shift * h_y - task["window_m"][1]) / pixel
            light = task["radiosity"][channel] * (m / side) ** 2
            if splat == "box":
                self.add(found, channel, dr.floor(column), dr.floor(row), light)
                continue
            column, row = column - 0.5, row - 0.5
            left, below = dr.floor(dr.detach(column)), dr.floor(dr.detach(row))
            right_share, upper_share = column - left, row - below
            for i, by_row in ((0, 1 - upper_share), (1, upper_share)):
                for j, by_column in ((0, 1 - right_share), (1, right_share)):
                    self.add(found, channel, left + j, below + i, light * by_row * by_column)
        return found

    def add(self, image: Any, channel: int, column: Any, row: Any, light: Any) -> None:
        m = self.task["pixels"]
        is_seen = (column >= 0) & (column < m) & (row >= 0) & (row < m)
        where = self.types.UInt32(row) * m + self.types.UInt32(column) + channel * m * m
        dr.scatter_reduce(dr.ReduceOp.Add, image, self.types.Float(light), where, is_seen)

    def call(self, side: int, splat: str, with_gradient: bool) -> Any:
        """One image, evaluated; its gradient too if asked for."""
        coefficients = self.types.Float(self.coefficients)
        if with_gradient:
            dr.enable_grad(coefficients)
        image = self.image(coefficients, side, splat)
        if with_gradient:
            dr.backward(dr.sum(image * self.weights))
            dr.eval(image, dr.grad(coefficients))
        else:
            dr.eval(image)
        dr.sync_thread()
        return image


def spline(t: Any) -> tuple[list[Any], list[Any]]:
    """Weights of four coefficients around a point, t in [0, 1), and their slopes per sample pitch."""
    s = 1 - t
    weights = [s**3 / 6, ((3 * t - 6) * t * t + 4) / 6, (((3 - 3 * t) * t + 3) * t + 1) / 6, t**3 / 6]
    slopes = [-s * s / 2, (3 * t - 4) * t / 2, ((2 - 3 * t) * t + 1) / 2, t * t / 2]
    return weights, slopes


def main() -> None:
    tracer: Tracer | None = None
    for line in sys.stdin:
        command = json.loads(line)
        if command["do"] == "setup":
            dr.set_thread_count(command["threads"])
            tracer = Tracer(command["task"], command["backend"])
            answer: Any = dr.__version__
        elif command["do"] == "image":
            assert tracer is not None
            m = tracer.task["pixels"]
            image = np.array(tracer.call(command["side"], command["splat"], False)).reshape(-1, m, m)
            np.save(command["to"], image)
            answer = None
        else:
            assert tracer is not None
            started = time.perf_counter()
            tracer.call(command["side"], command["splat"], command["do"] == "both")
            answer = 1e3 * (time.perf_counter() - started)
        print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
