"""What the evaluation report says around its tables."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING, Final

from egp_service._core import Library

if TYPE_CHECKING:
    from pathlib import Path

_BUILT_IN: Final = "CommonRoad's multi-body vehicle of 29 states"
_OWN: Final = "the simulator <code>{plant}</code>, except those of <i>prediction</i>, which use "
_ABOUT: Final = """Library: <code>{file}</code> (SHA-256 {id}) of the vehicle <i>{name}</i> of
{mass:g} kg, with the members {members}. All runs use {vehicle}. They have measurement noise unless
a condition says otherwise. The controllers have the same optimal control problem, solver, tuning
and gate and differ only in the model that predicts the vehicle; on roads of unknown friction they
have the same model and differ only in what their reference speed knows. Errors are errors of the
true state. The error of an incomplete run is the error up to its end, so errors and completions
must be read together.
Brackets are 95 % intervals over the seeds: Wilson's for shares, and expanded percentile intervals
of the bootstrap for medians (off track: for the mean). With few seeds these are too narrow: with
normal errors 75 % of them hold the true value with three seeds, 92 % with five. One run has
brackets for its share only. The settling time of a run is the median over its friction changes
under excitation. <i>No plan</i> counts control periods without a usable plan, and
<i>late</i> counts periods whose step took longer than the period while other runs shared the
machine. <i>No data</i> means that no run gives the figure, and claims about experiments that were
not run are left out.
Command: <code>{command}</code>"""

CLAIMS: Final = """Below the limit the errors of the best controllers differ by millimetres, while
positions are measured to 2 cm. At 95 and 100 % of the grip the ensemble has a larger error than the
oracle for two reasons. First, on straights surfaces are hardly distinguishable, and a car that
accelerates below its limit appears to have more grip, so that the weights drift and must return at
the next bend. Second, in a bend the blend that predicts best at the present slip overestimates the
additional force at larger slip, because tyre forces saturate at smaller slip on lower friction. A
bias to the inside of the bend, such as that of <i>forward Euler</i>, reduces this error. With
noise, the weights cannot settle before a window of measurements determines the friction; the
section after the friction steps gives the accuracy of this determination."""

DIFFERENCES: Final = """The paper's controller runs at 30 Hz with OSQP and linearises about zero
inputs; this system runs at 50 Hz and linearises about the last plan. The paper's weights add m/s
to rad/s, assume independent errors in the window and have no memory, as <i>paper's weights</i>
here; this system weights the window by the covariance of its errors due to model and measurement
noise, at the levels of largest likelihood. The paper's GPs predict whole changes and return to
constants without data, as <i>constant mean</i> here; the GPs of this system correct a single-track
vehicle fitted to the same data, and <i>fitted single-track</i> is this vehicle without GPs. The
training data of <i>constant mean</i> are the laps driven with the fitted vehicles. The paper's
positions move along the yaw at the start of each period, as with <i>forward Euler</i> here, so
that its predictions leave every bend to the outside and the vehicle drives on the inside; in this
system positions move along the yaw in the middle of the period. All controllers here bound the
slip of the front tyres near their peak, which depends on the estimated friction, and the drive by
the load of the wheels inside a bend, and weigh the change of the force from the previous plan. The
paper's reference moves at the present speed; here it follows a speed profile that contains the
braking. Corrections of a vehicle are learned with one kernel for all three outputs, whole changes
with one kernel per output, as in the paper. Tracks are computed from their definitions or drawn
from a seed; frictions are those of the paper's text."""

LAPS: Final = """ The second table has medians of ratios to the oracle's times, for each lap over
the same seeds: those of which both completed all laps."""

DEPARTURES: Final = """ Each departure was driven again, in the same states up to the last border of
surfaces before it, and from there on by a controller that is told all zones: with the oracle's
weights, and a reference speed that is planned for the true friction from the present speed on. The
departure was <i>avoidable</i> if this one stays on the road until 100 m beyond the place. If it
departs, too, the vehicle <i>came too fast</i>, and only a more careful reference speed avoids this.
A run that took too long or that the gate stopped is no departure, and a departure whose replay ends
so is not counted."""

DISTURBANCES: Final = """ The second table has the mean difference to the ensemble, paired by seed,
with its bootstrap interval; it is positive where the ensemble is closer to the path. In the last
column both have the members of the undisturbed vehicle, and it is positive where the residual
helps."""

BEST: Final = """Completed runs and the median lateral RMS error. The best baseline is the one that
completes most runs and among these has the smallest median error; variants of the ensemble are not
among them. Where the controllers differ only in what their reference speed knows, the condition
names the one that stands for the ensemble, and times replace errors. <code>egp evaluate</code>
prints the same table."""


def about(command: str, file: Path, plant: str | None) -> str:
    """Return the report's first paragraph: library, simulator, and the command that made it."""
    library = Library.load(file)
    own = "" if plant is None else _OWN.format(plant=html.escape(plant))
    return _ABOUT.format(
        file=html.escape(str(file)),
        id=library.id,
        name=html.escape(library.vehicle),
        mass=library.parameters.mass,
        members=", ".join(f"<i>{html.escape(member.label)}</i>" for member in library.members),
        vehicle=own + _BUILT_IN,
        command=html.escape(command),
    )
