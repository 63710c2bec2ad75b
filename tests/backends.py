"""The backends on which properties are tested, and how near to exact each of them is."""

import os
from collections.abc import Mapping
from typing import Any

import pytest

import oitlab
from oitlab.rendering import check_variants

try:
    DEVICE: oitlab.gpu.GpuInfo | None = oitlab.gpu.info()
    WHY_NOT = ""
except RuntimeError as error:
    DEVICE, WHY_NOT = None, str(error)

if DEVICE is None and os.environ.get("OITLAB_REQUIRE_GPU"):
    raise RuntimeError(WHY_NOT)  # where there has to be a driver, its absence is no reason to skip

BACKENDS = ["cpu", pytest.param("gpu", marks=pytest.mark.skipif(DEVICE is None, reason=WHY_NOT))]

F32 = 2.0**-24
"""What rounding to single precision is off by, relative."""


def refusal(
    source: oitlab.Scene | oitlab.Fragments, technique: str, params: Mapping[str, Any], backend: str
) -> str:
    """Tell why a backend has no form of what the CPU renders; empty where it has one."""
    check_variants(source, [(technique, params)])
    try:
        check_variants(source, [(technique, params)], backend)
    except (ValueError, MemoryError) as error:
        return str(error)
    return ""


def render(
    source: oitlab.Scene | oitlab.Fragments,
    technique: str,
    params: Mapping[str, Any] | None = None,
    *,
    backend: str,
) -> oitlab.Frame:
    """Render, or skip the test for the reason that the backend gives."""
    if reason := refusal(source, technique, params or {}, backend):
        pytest.skip(reason)
    return oitlab.render(source, technique, params, backend=backend)  # type: ignore[arg-type]
