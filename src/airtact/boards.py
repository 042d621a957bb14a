"""Boards of transducers by name, arrays made of them, and the calibration of their elements."""

from airtact.transducers.boards import Board, board_named, poses_of_boards
from airtact.transducers.calibration import load_calibration
from airtact.transducers.element import Element
from airtact.transducers.layout import board_array, join

__all__ = [
    "Board",
    "Element",
    "board_array",
    "board_named",
    "join",
    "load_calibration",
    "poses_of_boards",
]
