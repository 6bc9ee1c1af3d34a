"""The control step in this process: no network, the same request, the same bytes back."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from egp_service._core import EgpError, Engine
from egp_service.stepper import Answer, Stepper

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


class Controller(Stepper):
    """Drive with a library file, computed here; the README shows a lap with it."""

    def __init__(
        self,
        library: str | Path,
        settings: str = "",
        *,
        gate: Mapping[str, float],
        want_sigma: bool = False,
    ) -> None:
        """Load and verify a library; `settings` is TOML over the control step's defaults.

        `gate` holds the limits of the vehicle that is driven, as `VehicleParameters.gate_limits`
        gives them, and may hold `max_tail_ticks` and `stop_deceleration`.

        Raises `EgpError` for a library, settings or gate settings that are refused.
        """
        self._engine = Engine(str(library), settings)
        super().__init__(
            library=self._engine.library_id,
            dt=self._engine.dt,
            horizon=self._engine.horizon,
            history=self._engine.history,
            members=self._engine.members,
            gate=gate,
            want_sigma=want_sigma,
        )

    def _ask(self, request: bytes, sequence: int, deadline: float) -> Answer:
        del sequence, deadline  # the answer is this request's, and there is nobody else to ask
        start = time.perf_counter()
        try:
            reply = self._engine.step(request)
        except EgpError as error:
            return Answer(None, detail=str(error), refused=True)
        return Answer(reply, compute=time.perf_counter() - start, replica="in-process")
