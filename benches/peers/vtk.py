"""VTK off screen, unlit, no multisampling, 8 bits per channel.

wboit is VTK's own order-independent pass (its default), depth_peeling peels without a limit and with an
occlusion ratio of zero, which is as exact as VTK gets.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy

NO_LIMIT = 100_000


def _actor(arrays: Any) -> Any:
    vertices, faces, colors = arrays.for_gpu()
    points, cells, data = vtk.vtkPoints(), vtk.vtkCellArray(), vtk.vtkPolyData()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(vertices), deep=True))
    ids = [np.arange(0, faces.size + 1, 3, dtype=np.int64), faces.astype(np.int64).ravel()]
    cells.SetData(*(numpy_to_vtkIdTypeArray(part, deep=True) for part in ids))
    data.SetPoints(points)
    data.SetPolys(cells)
    data.GetPointData().SetScalars(numpy_to_vtk((colors * 255).round().astype(np.uint8), deep=True))
    mapper, actor = vtk.vtkPolyDataMapper(), vtk.vtkActor()
    mapper.SetInputData(data)
    mapper.SetColorModeToDirectScalars()
    actor.SetMapper(mapper)
    actor.ForceTranslucentOn()
    actor.GetProperty().LightingOff()
    actor.GetProperty().SetInterpolationToFlat()
    return actor


def _aim(camera: Any, arrays: Any) -> None:
    camera.SetPosition(arrays.eye)
    camera.SetFocalPoint(arrays.target)
    camera.SetViewUp(arrays.up)
    camera.SetViewAngle(arrays.fov_y)
    camera.SetClippingRange(arrays.near, arrays.far)


def setup(arrays: Any, mode: str) -> Callable[[], Any]:
    peeling = mode == "depth_peeling"
    renderer, window = vtk.vtkRenderer(), vtk.vtkRenderWindow()
    renderer.AddActor(_actor(arrays))
    renderer.SetBackground(arrays.background)
    renderer.SetUseDepthPeeling(peeling)
    renderer.SetUseOIT(not peeling)
    renderer.SetMaximumNumberOfPeels(NO_LIMIT)
    renderer.SetOcclusionRatio(0.0)
    _aim(renderer.GetActiveCamera(), arrays)
    window.SetOffScreenRendering(1)
    window.SetAlphaBitPlanes(1)
    window.SetMultiSamples(0)
    window.SetSize(arrays.width, arrays.height)
    window.AddRenderer(renderer)
    pixels = vtk.vtkUnsignedCharArray()

    def frame() -> Any:
        window.Render()
        window.GetPixelData(0, 0, arrays.width - 1, arrays.height - 1, 0, pixels, 0)
        return vtk_to_numpy(pixels).reshape(arrays.height, arrays.width, 3)[::-1].copy()

    frame.info = {"version": vtk.vtkVersion.GetVTKVersion(), "renderer": window.GetClassName()}  # type: ignore[attr-defined]
    return frame
