"""The backends: one protocol, and numpy, OpenCL and Warp, which implement it in one folder each."""

from __future__ import annotations

from .cells import gaussian_taps
from .cosines import Cosines
from .dispatch import Chosen, absent, auto, devices, get, left_out, names, several, why_auto
from .duality import BALL_ROUNDINGS
from .groups import GroupForm, Groups
from .patches import PatchForm, over_patches
from .protocol import Backend
from .recorded import Recorded, in_turns
from .sums import Numbers, Ratio
from .types import Array, BackendUnavailable, Box, Conductance, Device, LeftOut, Smoothness, Storage, Weighted

__all__ = [
    "BALL_ROUNDINGS",
    "Array",
    "Backend",
    "BackendUnavailable",
    "Box",
    "Chosen",
    "Conductance",
    "Cosines",
    "Device",
    "GroupForm",
    "Groups",
    "LeftOut",
    "Numbers",
    "PatchForm",
    "Ratio",
    "Recorded",
    "Smoothness",
    "Storage",
    "Weighted",
    "absent",
    "auto",
    "devices",
    "gaussian_taps",
    "get",
    "in_turns",
    "left_out",
    "names",
    "over_patches",
    "several",
    "why_auto",
]
