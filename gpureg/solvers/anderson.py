"""Anderson acceleration of a fixed-point process f <- J(f): the next iterate is a mix of the last images J(f).

Every `PERIOD` iterations the residual r = J(f) - f is stored. With the differences of these residuals and of the images
as columns of dR and dG, the candidate is J(f) - dG c, where c minimises |r - dR c| (Anderson 1965; Walker and Ni 2011,
eq. 2.2). The plain sweeps between are cheap and smooth the iterate (Pratapa, Suryanarayana and Pask 2016).

Everything stays on the device: the inner products, the c, and whether a mix is accepted. So the device may be far
behind the host, and what is launched is the same in both cases.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..backends import Array, Backend, Numbers, Ratio, Recorded, scalars
from ..model.on_device import DeviceProblem

# Differences in the history, and iterations between mixes. Measured on total variation of a 128 x 128 image (eps 1e-3
# of the range, to a distance of 1e-4; 1502 plain sweeps): a mix in each iteration, with the differences of single
# sweeps, takes 184 iterations with 10 products each; in every third 111 with 10; these numbers 152 with 2.75.
MEMORY = scalars.MEMORY
PERIOD = 4


@dataclass(frozen=True)
class Anderson:
    """Anderson acceleration of a process that does not raise the energy, with mixes that do not raise it either.

    Attributes
    ----------
    numbers : Numbers
        The scalars.
    pairs : list of pairs of device functions, (n, m)
        Places: differences of residuals and images of consecutive stored sweeps, and in one place the residual and
        image of the last one. The places take turns.
    spare : device function, (n, m)
        Buffer for the mix.
    records : dict of Recorded
        The launches of stored sweeps, by the place and the number of differences and the iterate that they begin from.
    stored : int
        Stored sweeps so far.
    since : int
        Sweeps since the last stored one.
    """

    numbers: Numbers
    pairs: list[tuple[Array, Array]]
    spare: Array
    records: dict[tuple[int, int, int], Recorded]
    stored: int = 0
    since: int = 0

    @classmethod
    def of(cls, problem: DeviceProblem, numbers: Numbers) -> Anderson:
        """Make an acceleration with an empty history."""
        return cls(numbers, [], problem.backend.empty(problem.weighted.graph, problem.channels), {})

    def begun_anew(self) -> Anderson:
        """Return the acceleration with an empty history."""
        return replace(self, stored=0, since=0)

    def after(self, problem: DeviceProblem, f: Array, image: Array, at: int) -> Anderson:
        """Add a sweep from f to its image, (n, m) both; every fourth time a mix takes the image's place.

        `at` is the place of f among the two iterates. A mix that would raise the energy is rejected, and the older half
        of the history is dropped.
        """
        if self.since + 1 < PERIOD:
            return replace(self, since=self.since + 1)
        place, count = self.stored % scalars.PLACES, min(self.stored, MEMORY)
        if place == len(self.pairs):
            empty, graph, m = problem.backend.empty, problem.weighted.graph, problem.channels
            self.pairs.append((empty(graph, m), empty(graph, m)))
        work = self.records.get((place, count, at))
        if work is None:

            def mix(backend: Backend) -> None:
                self._store(backend, problem, f, image, place, count)
                if count:
                    self._mix(backend, problem, f, image, place, count)

            work = self.records[place, count, at] = Recorded(problem.backend, mix)
        work()
        return replace(self, stored=self.stored + 1, since=0)

    def _store(self, backend: Backend, problem: DeviceProblem, f: Array, image: Array, place: int, count: int) -> None:
        """Store the sweep; the last one becomes the newest difference."""
        graph, (residual, copy) = problem.weighted.graph, self.pairs[place]
        backend.combine(graph, 1.0, image, -1.0, f, out=residual)
        backend.copy(graph, image, out=copy)
        if not count:
            return
        newest = self.pairs[place - 1]
        for now, last in zip((residual, copy), newest, strict=True):
            backend.combine(graph, 1.0, now, -1.0, last, out=last)
        for k in _places(place, count):
            backend.dot_into(self.numbers[scalars.ROW + k], graph, newest[0], self.pairs[k][0])
        backend.dot_into(self.numbers[scalars.PRODUCT], graph, newest[0], residual)
        backend.mix_coefficients(self.numbers, (place - 1) % scalars.PLACES)

    def _mix(self, backend: Backend, problem: DeviceProblem, f: Array, image: Array, place: int, count: int) -> None:
        """Write the candidate for the next iterate over the image if its energy is at most that of f."""
        graph, numbers, mixed = problem.weighted.graph, self.numbers, self.pairs[place][1]
        for k in _places(place, count):
            share = Ratio(numbers, scalars.COEFFICIENTS + k, scalars.ONE, -1.0)
            mixed = backend.combine(graph, share, self.pairs[k][1], 1.0, mixed, out=self.spare)
        for g, to in ((mixed, scalars.MIXED), (f, scalars.BEFORE)):
            backend.energy_into(numbers[to], problem.weighted, g, problem.f0, problem.lam, problem.model)
        # no tolerance for rounding: it takes 3.5 times as many iterations (measured)
        backend.judge_mix(numbers)
        taken, left = (Ratio(numbers, to, scalars.ONE) for to in (scalars.TAKEN, scalars.LEFT))
        backend.combine(graph, taken, mixed, left, image, out=image)

    def describe(self, rejected: int, mixes: int) -> str:
        """Describe the mixes, as a clause."""
        return (
            f"one iterate in {PERIOD} mixed from {MEMORY + 1} sweeps at most (Anderson), "
            f"{rejected} of {mixes} mixes rejected"
        )


def _places(place: int, count: int) -> list[int]:
    """Return the places of `count` differences before a place, the oldest first."""
    return [(place - 1 - k) % scalars.PLACES for k in reversed(range(count))]
