"""Frame of a track, and its relation to the frame of the fixes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pdr_filter.filter.imm.motion_model import MAX_HEADING_VARIANCE
from pdr_filter.filter.pedestrian.alignment import Alignment, Pose
from pdr_filter.filter.pedestrian.frame_rotation import (
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
    spaced_pairs,
)
from pdr_filter.values import MAX_NORTH_STD_RAD, FloatArray, Origin, wrap_angle

# One in twenty correct headings has a larger conflict with the positions. Above it the frame is not joined until more
# positions are available.
_UNSURE = 3.84


@dataclass(frozen=True, eq=False)
class Frame:
    """Relation between the frame of the filter states and the frame of the fixes.

    A track begins in its start frame, with unknown position and north. Fixes determine the shift and the rotation. The
    frame is joined when the filter states are transformed into the frame of the fixes. A new frame with unknown
    rotation begins where the heading is lost. In `START_FRAME` the fixes are relative to the start, so that it is
    joined from the beginning. Its north is unknown until a heading fix determines it, or until position fixes confirm
    the direction of the start.
    """

    # True if the filter states are in the frame of the fixes. Unlike `is_known`, this concerns the filter states and
    # not the reported positions.
    is_joined: bool
    # number of steps before the present frame began where the heading was lost, or 0 for the start frame
    since: int = 0
    # Fixes since the present frame began, each with the track position at its time, until the frame is joined. After a
    # lost heading the first pair is the track position at the loss.
    pairs: tuple[PairedPoint, ...] = ()
    agreeing: tuple[PairedPoint, ...] = ()  # members of `pairs` that are consistent with each other
    # density of the rotation from the present frame to the frame of the fixes, given the consistent pairs
    rotation: RotationDensity | None = None
    compass: Compass | None = None  # magnetic north, until the frame is joined
    # Prior variance of the rotation before any position fix, or infinity if it is unknown. In a joined frame it is the
    # variance with which used fixes determine the rotation, 0 if the rotation was estimated.
    north_var_rad2: float = math.inf
    # decrease of the misfit of the pairs (`disagreement`) if the prior with variance `north_var_rad2` is omitted
    north_conflict: float = 0.0
    north: Alignment | None = None  # rotation of the start frame by a heading fix, before any position fix
    alignment: Alignment | None = None  # alignment of the start frame with the frame of the fixes
    # alignments of the frames after a lost heading, and relocations of the track by fixes
    later: tuple[Alignment, ...] = ()

    @property
    def relocations(self) -> tuple[Alignment, ...]:
        """Alignments by which fixes have relocated the track, each valid from step `n_steps` on.

        A track is relocated if rejected fixes agree with each other but not with the track. It is then shifted and
        rotated to these fixes.
        """
        return tuple(each for each in self.later if each.since == each.n_steps)

    @property
    def rotation_var_rad2(self) -> float:
        """Variance in rad2 of the rotation from the track to the frame of the fixes, beyond the filter states.

        It is 0 if the frame is joined: the filter states are in the frame of the fixes and contain the variance of the
        rotation. It is also 0 if neither a fix nor a compass shows the rotation yet.
        """
        if self.is_joined:
            return 0.0
        rotation = self._provisional or self._density
        return rotation.angle_var_rad2 if rotation else 0.0 if self._north is None else self._north.std_rad**2

    @property
    def is_of_start(self) -> bool:
        """True if the frame of the fixes is the start frame, so that no fix aligns the start of the track."""
        return self.alignment is None and (self.is_joined or self.since > 0)

    @property
    def is_known(self) -> bool:
        """True if positions are in a frame of fixes that is not the start frame, even if the rotation is uncertain."""
        return not self.is_of_start and (self.rotation is not None or self.alignment is not None)

    @property
    def is_rotation_estimated(self) -> bool:
        """True if fixes have determined the rotation of the track, at its start or after a lost heading."""
        return self.alignment is not None or len(self.later) > len(self.relocations)

    @property
    def name(self) -> str:
        """Name of the frame of the positions.

        It is "fixes" for the frame of the position fixes. The other names are of frames with the origin at the start:
        "north" if the compass, "heading fixes" if a heading fix has rotated the track, and "start" otherwise.
        """
        if self.is_known:
            return "fixes"
        if self._north is not None:
            return "north"
        return "start" if self.north is None else "heading fixes"

    @property
    def _north(self) -> Compass | None:
        """Compass that names the direction of north, or None."""
        compass = self.compass
        return None if compass is None or compass.std_rad > MAX_NORTH_STD_RAD else compass

    @cached_property
    def _density(self) -> RotationDensity | None:
        """Density of the rotation given fixes and compass, or None before the first fix and in a joined frame."""
        return None if self.rotation is None else self.rotation.with_compass(self.compass)

    @property
    def is_north_wrong(self) -> bool:
        """True while the positions contradict the prior of the rotation, as after a wrong heading fix.

        The misfit of the positions is computed with and without the prior. The misfit is the sum of the normalised
        squared errors, plus a constant for each position that is removed as inconsistent (`disagreement`). The prior is
        wrong if its omission reduces the misfit by more than the 99.9 % limit of chi-square with one degree of freedom.
        """
        return self.north_conflict > agreement_limit(1)

    @property
    def rotation_prior_var_rad2(self) -> float:
        """Prior variance of the rotation before any position fix, infinite if positions contradict it."""
        return math.inf if self.is_north_wrong else self.north_var_rad2

    @cached_property
    def _provisional(self) -> Alignment | None:
        """Alignment of a frame that is not joined but has a prior of its rotation, such as a heading fix.

        The result is None before the first position fix, without such a prior, or if the rotation is still too
        uncertain.
        """
        if self._density is None or math.isinf(self.rotation_prior_var_rad2) or not self._density.is_narrow:
            return None
        return align(self.agreeing, 0, self.rotation_prior_var_rad2, self.compass)

    def world(self, pose: Pose) -> Pose:
        """Convert a pose (position and heading) to the frame of the fixes, with the current estimate of the rotation.

        The frame of the pose follows from its number of steps: the frame of the start, or the frame that began where
        the heading was lost. A pose of a frame with unknown rotation is returned unchanged.
        """
        for alignment in (self.north, self.alignment, *self.later):
            if alignment is not None and alignment.applies_to(pose):
                pose = alignment.world(pose)
        if self.is_joined or pose.n_steps < self.since:
            return pose
        rotation = self._provisional or self._density or self.present_alignment
        return pose if rotation is None else rotation.world(pose)

    def origin(self, given: Origin) -> Origin:
        """Return the geographic origin of the fixes, with the estimated rotation and the errors of the start frame.

        `turn_rad` and `turn_std_rad` are the rotation from the start frame to the frame of the fixes and its standard
        deviation. The rotation includes a heading fix before the first position fix. `position_std_m` is the standard
        deviation of the shift along each axis. Without any estimate the origin is returned unchanged.
        """
        before_rad = 0.0 if self.north is None else self.north.angle_rad
        rotation = self.alignment or self._provisional or self._density
        if rotation is None:
            return given
        return replace(
            given,
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
        """Return the frame with one more point pair, and the rotation estimated again.

        Beyond `MAX_PAIRS` pairs, the pairs are thinned to about even intervals of time.
        """
        return replace(self, pairs=spaced_pairs((*self.pairs, pair), MAX_PAIRS))._reestimated()

    def _reestimated(self) -> Frame:
        """Return the frame with consistent pairs selected again, and the rotation estimated from them.

        If the positions contradict the prior of the rotation, the prior is not used. A frame without pairs is
        unchanged.
        """
        if not self.pairs:
            return self
        # the position at a lost heading is kept; `relocation` handles the case that it is wrong
        n_sure = 1 if self.since else 0
        agreeing, rotation = consistent_pairs(self.pairs, self.north_var_rad2, n_sure)
        if self.is_of_start and len(agreeing) == 1:
            # Without fixes, the mean over all angles would stay at the lost heading. The drawn track keeps its shape.
            rotation = rotation.most_probable()
        turned = replace(self, agreeing=agreeing, rotation=rotation, north_conflict=0.0)
        if self.is_open:
            return turned
        free_agreeing, free_rotation = consistent_pairs(self.pairs, math.inf, n_sure)  # without the prior of north
        with_prior = disagreement(self.pairs, agreeing, self.north_var_rad2)
        turned = replace(turned, north_conflict=with_prior - disagreement(self.pairs, free_agreeing, math.inf))
        return replace(turned, agreeing=free_agreeing, rotation=free_rotation) if turned.is_north_wrong else turned

    def with_north(self, north: Alignment) -> Frame:
        """Return the frame after a heading fix has rotated it.

        `north` is the alignment by this fix. Its angle variance becomes the prior variance of the remaining rotation to
        the frame of the fixes.
        """
        frame = replace(self, compass=None, north_var_rad2=north.angle_var_rad2)
        frame = replace(frame, later=(*self.later, north)) if self.since else replace(frame, north=north)
        return frame._reestimated()

    def with_compass(self, compass: Compass | None) -> Frame:
        """Return the frame with the present magnetic north, or None if it is unknown.

        A frame that is joined, or whose rotation a heading fix has determined, is unchanged. So is a frame that leads
        to the start frame, whose north is unknown.
        """
        return replace(self, compass=compass) if self.is_open and not self.is_of_start else self

    @property
    def is_settled(self) -> bool:
        """True if the frame can be joined.

        The track must be as uncertain as its fixes, and the rotation known well enough. Positions and the compass may
        determine the rotation, with its prior. An earlier heading fix alone is not sufficient: positions must determine
        the rotation without it, and agree with it.
        """
        rotation = self._density if self._is_track_uncertain else None
        if rotation is not None and self.rotation_prior_var_rad2 <= MAX_ANGLE_STD_RAD**2:
            if self.north_conflict > _UNSURE:
                return False
            rotation = rotation_density(self.agreeing).with_compass(self.compass)
        return rotation is not None and rotation.is_narrow

    @property
    def _is_track_uncertain(self) -> bool:
        """True if the error of the track since the first pair is as large as the error of the fixes.

        Until the error is so large, fixes rotate and shift the whole track. In a joined frame each fix corrects
        position and heading from then on, which bends the track.
        """
        walked_m2 = [pair.walked_var_m2 for pair in self.agreeing]
        return bool(walked_m2) and max(walked_m2) - min(walked_m2) > min(pair.var_m2 for pair in self.agreeing)

    @property
    def is_open(self) -> bool:
        """True if the rotation has no narrow prior and is not estimated yet, neither by positions nor by a heading fix.

        A joined frame is open only if it is the start frame.
        """
        return (not self.is_joined or self.is_of_start) and self.north_var_rad2 > MAX_ANGLE_STD_RAD**2

    @property
    def is_lost_before_north(self) -> bool:
        """True if the heading was lost in the start frame, before any fix since then and any heading fix at all."""
        return self.since > 0 and self.is_of_start and len(self.pairs) == 1 and self.north is None and not self.later

    def turns_about_start(self, angle_rad: float, var_rad2: float, n_steps: int) -> tuple[Alignment, Alignment]:
        """Return the alignments of the steps since the heading was lost and of those before, for the first heading fix.

        Both rotate about the start by one angle, to the north of the fix. `var_rad2` is the variance of the fix. The
        variance of the lost heading is one of the earlier steps, and therefore of the position at the loss.
        """
        lost_rad2, lost_m = min(self.north_var_rad2, MAX_HEADING_VARIANCE), self.pairs[0].track_m
        whole = Alignment(angle_rad, var_rad2 + lost_rad2, np.zeros(2), np.zeros(2), 0.0, self.since)
        spread_m2 = 0.5 * lost_rad2 * float(lost_m @ lost_m)
        turn = Alignment(angle_rad, var_rad2, lost_m, whole.positions(lost_m), spread_m2, n_steps, self.since)
        return turn, whole

    def with_whole_north(self, whole: Alignment, turn: Alignment) -> Frame:
        """Return the frame after a heading fix has rotated it by the alignments `turns_about_start`."""
        (lost,) = self.pairs
        lost = replace(lost, world_m=turn.world_centre_m, var_m2=lost.var_m2 + turn.centre_var_m2)
        return replace(self, north=whole, pairs=(lost,)).with_north(turn)

    def with_position(self, position_m: FloatArray, var_m2: float) -> Frame:
        """Return the joined frame after a used position fix, which confirms the direction of the start frame.

        The rotation about the start has the variance var / d^2 for a fix with the variance `var_m2` along each axis, at
        the distance d from the start.
        """
        if not self.is_open:
            return self
        information = 1.0 / self.north_var_rad2 + float(position_m @ position_m) / var_m2
        return replace(self, north_var_rad2=1.0 / information if information else math.inf)

    def with_alignment(self, alignment: Alignment) -> Frame:
        """Return the frame after the filter states have been transformed by an alignment.

        The alignment is stored to transform the steps before it.
        """
        frame = Frame(
            is_joined=True,
            north=self.north,
            alignment=self.alignment,
            later=self.later,
            north_conflict=self.north_conflict,
            north_var_rad2=0.0,
        )
        if self.since == 0:
            return replace(frame, alignment=alignment)
        if self.since == alignment.n_steps:  # no step was reported in the frame
            return frame
        return replace(frame, later=(*self.later, replace(alignment, since=self.since)))

    def with_lost_heading(self, pairs: tuple[PairedPoint, ...], rotation_var_rad2: float, n_steps: int) -> Frame:
        """Return the frame with an unknown rotation from the step at which the heading was lost.

        `n_steps` is the number of steps before the loss. The first of the pairs is the position at the loss.
        `rotation_var_rad2` is the prior variance of the rotation. From `MAX_HEADING_VARIANCE` on, the rotation has no
        prior.
        """
        var = rotation_var_rad2 if rotation_var_rad2 < MAX_HEADING_VARIANCE else math.inf
        return replace(self, is_joined=False, since=n_steps, pairs=pairs, north_var_rad2=var)._reestimated()

    def most_probable(self, n_steps: int) -> Alignment:
        """Return the alignment of the present frame with the frame of the fixes by the most probable rotation.

        The frame must not be joined. `n_steps` is the number of steps so far, to which the alignment applies. Raises
        ValueError if the frame has no density of the rotation, as before the first fix and in a joined frame.
        """
        if self._density is None:
            raise ValueError(
                "the rotation of this frame is not being estimated, because there is no position fix yet or the track "
                "is already in the frame of the fixes: use present_alignment or alignment"
            )
        return replace(self._provisional, n_steps=n_steps) if self._provisional else self._density.alignment(n_steps)

    @property
    def present_alignment(self) -> Alignment | None:
        """Most probable alignment of the present frame with the frame of the fixes.

        Before the first fix the alignment is the rotation by the compass. The result is None in a joined frame, whose
        states are already in the frame of the fixes. The result is also None if neither fixes nor a compass show the
        rotation.
        """
        if self.is_joined:
            return None
        if self._density is not None:
            return self.most_probable(0)
        if self._north is None:
            return None
        angle_rad, var_rad2 = self._north.angle_rad, self._north.std_rad**2
        return Alignment(angle_rad, var_rad2, np.zeros(2), np.zeros(2), 0.0, 0)

    def with_moved_track(self, alignment: Alignment) -> Frame:
        """Return the frame with the track positions of its pairs transformed by an alignment.

        The rotation is estimated again.
        """
        return replace(
            self, pairs=tuple(pair.with_moved_track(alignment.positions) for pair in self.pairs)
        )._reestimated()


START_FRAME = Frame(is_joined=True)


UNKNOWN_FRAME = Frame(is_joined=False)
