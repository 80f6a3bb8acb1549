"""Frame of a track, and its relation to the frame of the fixes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pdr_filter.filter.fixes.alignment import Alignment, Place
from pdr_filter.filter.fixes.frame_rotation import (
    MAX_ANGLE_STD_RAD,
    MAX_PAIRS,
    Compass,
    PairedPoint,
    RotationDensity,
    agreement_limit,
    align,
    consistent_pairs,
    disagreement,
    rotation_density,
    thinned,
)
from pdr_filter.filter.imm.motion_model import MAX_HEADING_VARIANCE
from pdr_filter.values import Origin, wrap_angle

# One in twenty correct headings has a larger conflict with the positions. Above it the frame is not joined until more
# positions are available.
_UNSURE = 3.84


@dataclass(frozen=True, eq=False)
class Frame:
    """Relation between the track and the frame of the fixes.

    Attributes
    ----------
    is_joined : bool
        True if the filter states are in the frame of the fixes.
    since : int
        Number of steps before the heading was lost and a new frame began, or 0 for the start frame.
    pairs : tuple of PairedPoint
        Fixes since then, until the frame is joined. After a lost heading the first pair is the position at the loss.
    agreeing : tuple of PairedPoint
        Those pairs that are consistent.
    rotation : RotationDensity or None
        Density of the rotation given the consistent pairs.
    compass : Compass or None
        Magnetic north, until the frame is joined.
    north_var_rad2 : float
        Prior variance of the rotation before any position fix, or infinity if it is unknown.
    north_conflict : float
        Decrease of the normalised squared errors of the positions without this prior.
    north : Alignment or None
        Rotation of the start frame by a heading fix, before any position fix.
    alignment : Alignment or None
        Alignment of the start frame with the frame of the fixes.
    later : tuple of Alignment
        Alignments of the frames after a lost heading, and relocations of the track by fixes.
    """

    is_joined: bool
    since: int = 0
    pairs: tuple[PairedPoint, ...] = ()
    agreeing: tuple[PairedPoint, ...] = ()
    rotation: RotationDensity | None = None
    compass: Compass | None = None
    north_var_rad2: float = math.inf
    north_conflict: float = 0.0
    north: Alignment | None = None
    alignment: Alignment | None = None
    later: tuple[Alignment, ...] = ()

    @property
    def relocations(self) -> tuple[Alignment, ...]:
        """Relocations of the track by fixes, each valid from its step on (see `relocation`)."""
        return tuple(each for each in self.later if each.since == each.n_steps)

    @property
    def rotation_var_rad2(self) -> float:
        """Variance of the rotation that is not in the filter states, which is 0 for a joined frame."""
        if self.is_joined:
            return 0.0
        rotation = self._provisional or self._density
        return rotation.angle_var_rad2 if rotation else 0.0 if self.compass is None else self.compass.std_rad**2

    @property
    def is_known(self) -> bool:
        """True if positions are in the frame of the fixes, even if the rotation is still uncertain."""
        return self.rotation is not None or self.alignment is not None

    @property
    def name(self) -> str:
        """Name of the frame of the positions.

        It is "fixes" for the frame of the fixes, "north" for the start frame with true north, and "start" for the start
        frame.
        """
        if self.is_known:
            return "fixes"
        return "start" if self.compass is None else "north"

    @cached_property
    def _density(self) -> RotationDensity | None:
        """Density of the rotation given fixes and compass, or None before the first fix and in a joined frame."""
        return None if self.rotation is None else self.rotation.with_compass(self.compass)

    @property
    def is_north_wrong(self) -> bool:
        """True while the positions contradict the prior of the rotation, as after a wrong heading fix.

        A wrong heading has the same cost as an outlier at the limit of its gate. So has each position that is removed.
        """
        return self.north_conflict > agreement_limit(1)

    @property
    def rotation_prior_var_rad2(self) -> float:
        """Prior variance of the rotation before any position fix, infinite if positions contradict it."""
        return math.inf if self.is_north_wrong else self.north_var_rad2

    @cached_property
    def _provisional(self) -> Alignment | None:
        """Alignment by a heading that the positions do not confirm yet, or None without such a heading."""
        if self._density is None or math.isinf(self.rotation_prior_var_rad2) or not self._density.is_narrow:
            return None
        return align(self.agreeing, 0, self.rotation_prior_var_rad2, self.compass)

    def world(self, place: Place) -> Place:
        """Convert a place to the coordinate frame of the fixes, with the current estimate of the rotation.

        The frame of the place follows from its number of steps: the frame of the start, or the frame that began
        where the heading was lost.
        """
        for alignment in (self.north, self.alignment, *self.later):
            if alignment is not None and alignment.applies_to(place):
                place = alignment.world(place)
        if self.is_joined or place.n_steps < self.since:
            return place
        rotation = self._provisional or self._density or self.present_alignment
        return place if rotation is None else rotation.world(place)

    def origin(self, place: Origin) -> Origin:
        """Return the origin of the fixes with the present estimate of shift and rotation.

        The rotation is that of the start frame, including a heading fix before the first position fix.
        """
        before_rad = 0.0 if self.north is None else self.north.angle_rad
        rotation = self.alignment or self._provisional or self._density
        if rotation is None:
            return place
        return replace(
            place,
            turn_rad=float(wrap_angle(before_rad + rotation.angle_rad)),
            turn_std_rad=math.sqrt(rotation.angle_var_rad2),
            position_std_m=math.sqrt(rotation.centre_var_m2),
        )

    def at_most_probable_rotation(self) -> Frame:
        """Return the frame with an uncertain rotation fixed at its most probable angle.

        A track transformed by it keeps its shape, as needed for plots.
        """
        if self._density is None or self._provisional is not None:
            return self
        return replace(self, rotation=self._density.most_probable(), compass=None)

    def with_pair(self, pair: PairedPoint) -> Frame:
        """Return the frame with one more point pair."""
        return replace(self, pairs=thinned((*self.pairs, pair), MAX_PAIRS))._reestimated()

    def _reestimated(self) -> Frame:
        """Return the frame with the rotation estimated from its pairs."""
        if not self.pairs:
            return self
        # the position at a lost heading is kept; `relocation` handles the case that it is wrong
        n_sure = 1 if self.since else 0
        agreeing, rotation = consistent_pairs(self.pairs, self.north_var_rad2, n_sure)
        turned = replace(self, agreeing=agreeing, rotation=rotation, north_conflict=0.0)
        if self.is_open:
            return turned
        free_agreeing, free_rotation = consistent_pairs(self.pairs, math.inf, n_sure)  # without the prior of north
        with_prior = disagreement(self.pairs, agreeing, self.north_var_rad2)
        turned = replace(turned, north_conflict=with_prior - disagreement(self.pairs, free_agreeing, math.inf))
        return replace(turned, agreeing=free_agreeing, rotation=free_rotation) if turned.is_north_wrong else turned

    def with_north(self, north: Alignment) -> Frame:
        """Return the frame after a heading fix has rotated it.

        The remaining rotation has the variances of north and of the heading fix together.
        """
        frame = replace(self, compass=None, north_var_rad2=north.angle_var_rad2)
        frame = replace(frame, later=(*self.later, north)) if self.since else replace(frame, north=north)
        return frame._reestimated()

    def with_compass(self, compass: Compass) -> Frame:
        """Return the frame with the present magnetic north, unless a heading fix has determined the rotation."""
        return replace(self, compass=compass) if self.is_open else self

    @property
    def is_settled(self) -> bool:
        """True if the frame can be joined.

        The track must be as uncertain as its fixes, and the rotation known well enough. The rotation may be determined
        by positions, by the compass, and by an earlier heading fix.
        """
        rotation = self._density if self._is_track_uncertain else None
        if rotation is not None and self.rotation_prior_var_rad2 <= MAX_ANGLE_STD_RAD**2:
            if self.north_conflict > _UNSURE:
                return False
            rotation = rotation_density(self.agreeing).with_compass(self.compass)
        return rotation is not None and rotation.is_narrow

    @property
    def _is_track_uncertain(self) -> bool:
        """True if the error of the track since the first pair is as large as that of the fixes.

        Until then fixes rotate and shift the whole track. In a joined frame each fix corrects position and heading from
        then on, which bends the track.
        """
        walked_m2 = [pair.walked_var_m2 for pair in self.agreeing]
        return bool(walked_m2) and max(walked_m2) - min(walked_m2) > min(pair.var_m2 for pair in self.agreeing)

    @property
    def is_open(self) -> bool:
        """True if the frame is not joined and the rotation has no narrow prior.

        Only positions and the magnetic field then determine the rotation.
        """
        return not self.is_joined and self.north_var_rad2 > MAX_ANGLE_STD_RAD**2

    def joined(self, alignment: Alignment) -> Frame:
        """Return the frame after the filter states have been transformed by an alignment."""
        frame = Frame(
            is_joined=True,
            north=self.north,
            alignment=self.alignment,
            later=self.later,
            north_conflict=self.north_conflict,
        )
        if self.since == 0:
            return replace(frame, alignment=alignment)
        if self.since == alignment.n_steps:  # no step was reported in the frame
            return frame
        return replace(frame, later=(*self.later, replace(alignment, since=self.since)))

    def reopened(self, pairs: tuple[PairedPoint, ...], rotation_var_rad2: float, n_steps: int) -> Frame:
        """Return the frame with an unknown rotation from the step at which the heading was lost.

        The first of the pairs is the position at the loss. `rotation_var_rad2` is the prior variance of the rotation.
        """
        var = rotation_var_rad2 if rotation_var_rad2 < MAX_HEADING_VARIANCE else math.inf
        return replace(self, is_joined=False, since=n_steps, pairs=pairs, north_var_rad2=var)._reestimated()

    def most_probable(self, n_steps: int) -> Alignment:
        """Return the most probable alignment of a frame with uncertain rotation, to transform later steps."""
        if self._density is None:
            raise ValueError("the rotation of this frame is settled: use its alignment")
        return replace(self._provisional, n_steps=n_steps) if self._provisional else self._density.alignment(n_steps)

    @property
    def present_alignment(self) -> Alignment | None:
        """Most probable alignment of the present frame, or None if positions are already in the other frame."""
        if self.is_joined:
            return None
        if self._density is not None:
            return self.most_probable(0)
        if self.compass is None:
            return None
        angle_rad, var_rad2 = self.compass.angle_rad, self.compass.std_rad**2
        return Alignment(angle_rad, var_rad2, np.zeros(2), np.zeros(2), 0.0, 0)

    def moved(self, alignment: Alignment) -> Frame:
        """Return the frame with the track positions of its pairs transformed."""
        return replace(self, pairs=tuple(pair.moved(alignment.positions) for pair in self.pairs))._reestimated()


START_FRAME = Frame(is_joined=True)


UNKNOWN_FRAME = Frame(is_joined=False)
