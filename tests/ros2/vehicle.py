# mypy: disable-error-code="arg-type, no-any-return"
"""A vehicle of rmw_zenoh: the multi-body plant behind topics, in a process of its own.

    python -m ros2.vehicle tcp/127.0.0.1:7447 SECONDS SILENT

It has none of the adapter's code: keys are those of rmw_zenoh's design document, messages are
written by pycdr2. It publishes path and odometry at 50 Hz, drives with the Ackermann commands that
arrive, and is silent about odometry for the last SILENT seconds. It prints what happened as JSON.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from typing import Any

import numpy as np
import zenoh

from egp_service import Path as Road
from egp_service import Plant
from ros2 import idl

DT = 0.02
ODOMETRY = (
    "7/odom/nav_msgs::msg::dds_::Odometry_/"
    "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"
)
GID = bytes(range(16))


def pose(x: float, y: float, psi: float) -> idl.Pose:
    orientation = idl.Quaternion(0.0, 0.0, np.sin(0.5 * psi), np.cos(0.5 * psi))
    return idl.Pose(idl.Vector3(x, y), orientation)


def odometry(state: np.ndarray[Any, Any], l_r: float) -> bytes:
    """State of the rear axle's centre now, from that of the centre of mass."""
    seconds, rest = divmod(time.time_ns(), 10**9)
    p_x, p_y, v_x, psi, v_y, omega, _ = map(float, state)
    at = pose(p_x - l_r * np.cos(psi), p_y - l_r * np.sin(psi), psi)
    twist = idl.Twist(idl.Vector3(v_x, v_y - l_r * omega), idl.Vector3(0.0, 0.0, omega))
    return idl.Odometry(
        idl.Header(idl.Time(seconds, rest), "map"),
        "base_link",
        idl.PoseWithCovariance(at, [0.0] * 36),
        idl.TwistWithCovariance(twist, [0.0] * 36),
    ).serialize()


def road_message(road: Road) -> bytes:
    header = idl.Header(idl.Time(), "map")
    places = np.arange(0.0, road.length, 1.0)
    x, y, yaw, *_ = road.sample(places)
    poses = [idl.PoseStamped(header, pose(*map(float, at))) for at in zip(x, y, yaw, strict=True)]
    return idl.Path(header, poses).serialize()


def main(endpoint: str, seconds: float, silent: float) -> None:
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    road, plant = Road.rounded_rectangle(), Plant()
    l_r, mass = plant.parameters.l_r, plant.parameters.mass
    x, y, yaw, *_ = (float(column[0]) for column in road.sample(np.array([15.0])))
    plant.reset(x, y, yaw, 8.0)
    received: list[tuple[float, bytes, bytes]] = []
    controls: list[bytes] = []

    def keep(sample: zenoh.Sample) -> None:
        attachment = sample.attachment
        assert attachment is not None
        received.append((time.monotonic(), sample.payload.to_bytes(), attachment.to_bytes()))

    with zenoh.open(config) as session:
        session.declare_subscriber("7/drive/*/*", keep)
        session.declare_subscriber(
            "7/control/command/control_cmd/*/*", lambda s: controls.append(s.payload.to_bytes())
        )
        deadline = time.monotonic() + 60.0
        tokens: list[str] = []
        while len(tokens) < 5:
            assert time.monotonic() < deadline, tokens
            time.sleep(0.1)
            replies = session.liveliness().get("@ros2_lv/7/**")
            tokens = sorted(str(reply.ok.key_expr) for reply in replies if reply.ok)
        (path_key,) = (token.split("/") for token in tokens if "%plan/" in token)
        session.put(f"7/plan/{path_key[10]}/{path_key[11]}", road_message(road))
        time.sleep(0.2)
        lateral, stops, late = [], [], []
        begun = due = time.monotonic()
        sequence, speed_before = 0, 0.0
        while due - begun < seconds:
            if due - begun < seconds - silent:
                sequence += 1
                attachment = struct.pack("<qqB16s", sequence, time.time_ns(), 16, GID)
                payload = odometry(plant.vehicle_state, l_r)
                session.put(ODOMETRY, payload, attachment=attachment)
                speed_before = float(plant.vehicle_state[2])
                lateral.append(road.project(plant.vehicle_state[:2]).lateral)
            due += DT
            time.sleep(max(0.0, due - time.monotonic()))
            late.append(time.monotonic() - due)
            if received:
                drive = idl.AckermannDriveStamped.deserialize(received[-1][1]).drive
                u = np.array([mass * drive.acceleration, drive.steering_angle_velocity])
                plant.step(u, DT, 0.8)
                stops.append(drive.speed == 0.0 and drive.acceleration < 0.0)
    # The longest time between two commands, or by which a measurement was late.
    times = [arrival for arrival, _, _ in received]
    gap = max(*np.diff(times), *late)
    sequences = [struct.unpack("<qqB16s", attachment)[0] for _, _, attachment in received]
    last = idl.Control.deserialize(controls[-1])
    print(
        json.dumps(
            {
                "tokens": tokens,
                "commands": len(received),
                "gap": float(gap),
                "sequences": sequences == list(range(sequences[0], sequences[0] + len(sequences))),
                "lateral": float(np.max(np.abs(lateral))),
                "driven": float(road.project(plant.vehicle_state[:2]).s) - 15.0,
                "stopped_before_the_silence": any(stops[: int((seconds - silent) / DT) - 2]),
                "stopped_at_the_end": stops[-1],
                "control": [last.longitudinal.velocity, last.longitudinal.acceleration],
                "speed_before": speed_before,
                "speed": float(plant.vehicle_state[2]),
            }
        )
    )


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), float(sys.argv[3]))
