"""Shapes as points for a target: lines, circles, surfaces, text, SVG paths and pictures."""

from airtact.scene.drawings import picture, svg_path, text
from airtact.scene.target_points import circle, onto_surface, polyline, segment, sphere_shell, surface_points

__all__ = [
    "circle",
    "onto_surface",
    "picture",
    "polyline",
    "segment",
    "sphere_shell",
    "surface_points",
    "svg_path",
    "text",
]
