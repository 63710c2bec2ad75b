"""One scene as bare arrays, for peers that run without oitlab, and the matrices that they ask for."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import oitlab


@dataclass(frozen=True)
class Arrays:
    """Unlit triangles, one straight-alpha linear colour per face, under a perspective camera."""

    vertices: Any  # (V, 3) float32
    faces: Any  # (F, 3) int32
    face_colors: Any  # (F, 4) float32
    eye: Any
    target: Any
    up: Any
    background: Any
    fov_y: float  # degrees
    near: float
    far: float
    width: int
    height: int

    @classmethod
    def of(cls, scene: oitlab.Scene) -> Arrays:
        """Take a scene of one mesh apart."""
        (mesh,) = scene.meshes
        camera = scene.camera
        if mesh.color_domain != "face" or camera.fov_y is None:
            raise ValueError("peers draw face colours under a perspective camera")
        return cls(
            mesh.vertices.astype(np.float32),
            mesh.faces.astype(np.int32),
            mesh.colors.astype(np.float32),
            *(np.array(v, float) for v in (camera.eye, camera.target, camera.up, scene.background)),
            fov_y=camera.fov_y,
            near=camera.near,
            far=camera.far,
            width=scene.width,
            height=scene.height,
        )

    def save(self, path: Path) -> None:
        """Write an NPZ file."""
        np.savez(path, **asdict(self))

    @classmethod
    def load(cls, path: Path) -> Arrays:
        """Read what `save` wrote."""
        with np.load(path) as file:
            return cls(**{name: file[name] if file[name].ndim else file[name].item() for name in file})

    def view(self) -> Any:
        """World to eye as OpenGL has it: the camera looks along -z."""
        backward = self.eye - self.target
        backward = backward / np.linalg.norm(backward)
        right = np.cross(self.up, backward)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(backward, right), backward])
        matrix = np.eye(4)
        matrix[:3] = np.column_stack([rotation, -rotation @ self.eye])
        return matrix

    def projection(self) -> Any:
        """Eye to clip space as OpenGL has it: depths in [-1, 1]."""
        focal = 1 / np.tan(np.radians(self.fov_y) / 2)
        span = self.near - self.far
        return np.array(
            [
                [focal * self.height / self.width, 0, 0, 0],
                [0, focal, 0, 0],
                [0, 0, (self.near + self.far) / span, 2 * self.near * self.far / span],
                [0, 0, -1, 0],
            ]
        )

    def on_screen(self) -> Any:
        """(V, 3) float64: x and y in pixels, downwards, centres at .5; one over the depth."""
        matrix = self.projection()[[0, 1, 3]] @ self.view()
        clip = self.vertices.astype(float) @ matrix[:, :3].T + matrix[:, 3]
        inverse = 1 / clip[:, 2:]
        ndc = clip[:, :2] * inverse
        return np.hstack([(1 + ndc * (1, -1)) * (self.width / 2, self.height / 2), inverse])

    def rays(self) -> Any:
        """(H * W, 3) float32 unit directions through the pixel centres."""
        tangent = np.tan(np.radians(self.fov_y) / 2)
        x = (2 * np.arange(self.width) + 1 - self.width) * tangent / self.height
        y = (self.height - 1 - 2 * np.arange(self.height)) * tangent / self.height
        grid = np.broadcast_arrays(x[None, :], y[:, None], -1.0)
        directions = np.stack(grid, axis=-1).reshape(-1, 3) @ self.view()[:3, :3]
        return (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)

    def for_gpu(self) -> tuple[Any, Any, Any]:
        """Vertices, faces, vertex colours; vertices are repeated only where their faces differ in colour."""
        corner_colors = self.face_colors.repeat(3, axis=0)
        colors = np.empty((len(self.vertices), 4), np.float32)
        colors[self.faces.ravel()] = corner_colors
        if (colors[self.faces.ravel()] == corner_colors).all():
            return self.vertices, self.faces, colors
        corners = self.vertices[self.faces].reshape(-1, 3)
        return corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3), corner_colors
