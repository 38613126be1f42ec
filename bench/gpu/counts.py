"""What was counted of each kernel, and the time that a model of an H200 makes of it; no GPU has run for these.

Bytes are those that a call must move, each array once, or what the kernel reads twice as well where its header says so.
Instructions are those of the loops in the machine code that clang and ptxas made for sm_90, times the trips, and so are
the words of local memory. NVIDIA's own OpenCL compiler may make fewer.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Machine:
    """Rates of a GPU.

    Attributes
    ----------
    name : str
    copy : float
        Bytes per second of a copy, read and written.
    instructions : float
        Instructions of single lanes per second.
    words : float
        32-bit words of local memory per second.
    efficiency : float
        The share of the instruction rate that a loop is taken to reach.
    launch : float
        Seconds between two launches.
    host : float
        Bytes per second between host and device.
    """

    name: str
    copy: float
    instructions: float
    words: float
    efficiency: float
    launch: float
    host: float


# 132 multiprocessors x 4 warps of 32 lanes x 1.755 GHz; local memory serves a quarter of that; 4.3 TB/s is a copy that
# was measured by others.
H200 = Machine("H200", 4.3e12, 29.6e12, 7.4e12, 0.75, 3e-6, 5e10)


@dataclass(frozen=True)
class Count:
    """Counts per vertex, but launches per call.

    Attributes
    ----------
    bytes, instructions, words : float
        Of the device's memory, of a lane, of local memory; 0 where nothing was counted.
    launches : int
    host : float
        Bytes between host and device.
    source : str
        Where the numbers are from.
    """

    bytes: float
    instructions: float = 0.0
    words: float = 0.0
    launches: int = 1
    host: float = 0.0
    source: str = "bytes alone"

    def seconds(self, vertices: int, machine: Machine = H200) -> float:
        """The time of a call: the largest of the three bounds, and what does not overlap with them."""
        bounds = (
            self.bytes / machine.copy,
            self.instructions / (machine.instructions * machine.efficiency),
            self.words / machine.words,
        )
        return vertices * (max(bounds) + self.host / machine.host) + self.launches * machine.launch

    def bound(self, machine: Machine = H200) -> str:
        """What the largest bound is."""
        bounds = {
            "bandwidth": self.bytes / machine.copy,
            "instructions": self.instructions / (machine.instructions * machine.efficiency),
            "local memory": self.words / machine.words,
        }
        return max(bounds, key=lambda name: bounds[name])


# Pixels of a window of 21 x 21; work items of a tile of 64 x 32 or 64 x 16 per pixel that it writes.
WINDOW, TILE, SMALL_TILE = 441, 256 / (60 * 28), 256 / (60 * 12)
_LOOP, _TILE = "instructions of the loop", "instructions of a tile"

COUNTS: dict[str, Count] = {
    # f, f0 and the result once; weights once per pair; all instructions of a tile inside, with the hardware's rsqrt
    "sweep, 4 neighbours": Count(12, 573 * TILE, 75 * TILE, source=_TILE),
    "sweep, 8 neighbours, weights": Count(28, 1153 * TILE, 95 * TILE, source=_TILE),
    "sweep, 4 neighbours, RGB": Count(36, 636 * SMALL_TILE, 101 * SMALL_TILE, source=_TILE),
    "sweep, volume, 6 neighbours": Count(24, launches=2),
    # 25 instructions per 4 terms, and a second launch for what the groups found
    "dot": Count(8, 25 / 4, launches=2, source=_LOOP),
    "energy": Count(8, launches=2),
    "combine": Count(12),
    # y and the y before, read and written, at both ends of 4 edges; f twice
    "dual step, p = 1": Count(4 * (3 * 4 + 2)),
    "primal": Count(4 * (4 + 2)),
    "duality gap, p = 1": Count(4 * (4 + 2), launches=2),
    # an index and a weight per directed edge in both passes, f of the neighbour, pointers; degrees of the made graphs.
    # In OpenCL: a work item a row of roads; teams of 4 and pieces of long rows, which take two launches more
    "CSR sweep, roads": Count(2 * (2.4 * 12 + 4) + 16, 335, launches=2, source=_LOOP),
    "CSR sweep, scale-free": Count(2 * (8.5 * 12 + 4) + 16, 1297, launches=4, source=_LOOP),
    # per offset of the window, of the loop of similarity_step_gpu.cl on sm_90 with idle lanes; exponentials by a
    # polynomial
    "nonlocal means, 7x7": Count(8, 37.7 * WINDOW, 5.5 * WINDOW, source=_LOOP),
    "nonlocal means, 7x7, averaged": Count(8, 53.8 * WINDOW, 10.4 * WINDOW, source=_LOOP),
    "nonlocal means, 7x7, RGB": Count(24, 61.7 * WINDOW, 10.1 * WINDOW, source=_LOOP),
    "bilateral, 21x21": Count(8, 21.8 * WINDOW, 0.2 * WINDOW, source=_LOOP),
    # the averaged filter with Gaussian patches of a guide (63.5; RGB with 3 x 3 patches 71), then groups of 25 and 49
    # samples at every 36th pixel, for which 1.75 and 4.9 ms a megapixel were counted at every 16th; the image there and
    # back
    "denoise_image, grey": Count(
        8, 63.5 * WINDOW + (1.75 + 4.9) * 16 / 36 * 29.6e3, host=8, launches=12, source="the kernels, and 2 transfers"
    ),
    "denoise_image, grey, quality fast": Count(
        8, 63.5 * WINDOW, host=8, launches=6, source="the kernel, and 2 transfers"
    ),
    "denoise_image, RGB": Count(
        24, 71 * WINDOW + (4.5 + 20) * 16 / 36 * 29.6e3, host=24, launches=12, source="the kernels, and 2 transfers"
    ),
}
"""The counts by the name of a row of the table."""


def table(sides: tuple[int, ...] = (1024, 4096)) -> list[str]:
    """The predicted table as Markdown, ms for pictures of these sides."""
    head = "".join(f" {side} x {side} |" for side in sides)
    lines = [f"| on an H200, predicted, ms |{head} bound by | counted |", "|---|" + "---:|" * len(sides) + "---|---|"]
    for name, count in COUNTS.items():
        times = "".join(f" {1e3 * count.seconds(side * side):.3g} |" for side in sides)
        lines.append(f"| {name} |{times} {count.bound()} | {count.source} |")
    return lines
