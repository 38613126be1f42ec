"""The backends: one protocol, and numpy, OpenCL and Warp, which implement it in one folder each."""

from __future__ import annotations

from .cells import gaussian_taps
from .dispatch import absent, auto, devices, get, left_out, names, why_auto
from .duality import BALL_ROUNDINGS
from .groups import GroupForm, Groups
from .patches import PatchForm, over_patches
from .protocol import Backend
from .recorded import Recorded, in_turns
from .types import Array, BackendUnavailable, Conductance, Device, LeftOut, Smoothness, Storage, Weighted

__all__ = [
    "BALL_ROUNDINGS",
    "Array",
    "Backend",
    "BackendUnavailable",
    "Conductance",
    "Device",
    "GroupForm",
    "Groups",
    "LeftOut",
    "PatchForm",
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
    "why_auto",
]
