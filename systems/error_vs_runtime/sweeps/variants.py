"""What is varied about the systems that swing: integrators, time steps, forms, platforms and precisions."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

from systems.error_vs_runtime.integrators import available
from systems.error_vs_runtime.settings import Order, Setting

__all__ = ["DAMPED", "ORDER_STEPS", "PLAIN", "integrators_at", "orders", "variants"]

DAMPED, PLAIN = ("Verlet", "Euler-Cromer", "LangevinMiddle"), ("Verlet", "Euler-Cromer")
"""Integrators that are compared where a system damps its motion, and where not."""

ORDER_STEPS = (0.8, 0.4, 0.2)
"""Time steps over the stability limit where the order of convergence is measured."""


def integrators_at(segments: int, steps: tuple[float, ...], names: tuple[str, ...], **more: Any) -> list[Setting]:
    """Every integrator at every step."""
    return [Setting(segments, step, name, **more) for name in names for step in steps]


def variants(base: Setting, *, opencl: bool, form: bool = True) -> list[Setting]:
    """The same on other platforms, precisions and with the other form of bending."""
    out = [replace(base, form="arctangent")] if form else []
    if "CPU" in available():
        out.append(replace(base, platform="CPU"))
    if opencl and "OpenCL" in available():
        out += [replace(base, platform="OpenCL", precision=p) for p in ("single", "mixed", "double")]
    return out


def _of(name: str, longest: float, setting: Setting) -> bool:
    return setting.integrator == name and setting.platform == "Reference" and setting.step <= longest


def orders(names: tuple[str, ...], floor: float, longest: float = 0.85) -> list[Order]:
    """What theory expects of these integrators, up to the longest step."""
    theory = {"PEFRL": 4.0}
    return [
        Order(f"{name}, time step", "step", theory.get(name, 2.0), partial(_of, name, longest), floor) for name in names
    ]
