"""An outcome of a finished trial, of which tests replace what they are about."""

from egp_service.evaluation.campaign import Outcome

OUTCOME = Outcome(
    experiment="varying-speed",
    condition="90% of grip",
    contender="ensemble",
    seed=0,
    completed=True,
    reason="completed",
    time=30.0,
    distance=400.0,
    lap_times=(30.0,),
    lateral_max=0.3,
    lateral_rms=0.1,
    speed_rms=0.1,
    off_track=0.0,
    settling=(),
    resolution=None,
    avoidable=None,
    misses=0,
    late=0,
    step_ms=0.3,
)
