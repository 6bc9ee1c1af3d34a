"""The gymnasium environment."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from egp_service._core import InvalidArgumentError
from egp_service.simulation.environment import TrackEnvironment
from egp_service.simulation.plant import PlantError
from egp_service.simulation.scenario import Measurement, Track, load_scenario

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from egp_service.simulation.scenario import Scenario

DOCUMENT = Path(__file__).parents[2] / "docs/simulator.md"
CREEP = np.array([0.05, 0.0])


@pytest.mark.filterwarnings("ignore:.*Box observation space:UserWarning")
def test_it_is_an_environment_of_gymnasium() -> None:
    check_env(TrackEnvironment("rounded-rectangle"), skip_render_check=True)


def test_progress_is_the_reward_until_the_road_is_left() -> None:
    environment = TrackEnvironment("rounded-rectangle")
    observation, info = environment.reset()
    total, ended, truncated = 0.0, False, False
    while not (ended or truncated):
        observation, reward, ended, truncated, info = environment.step(CREEP)
        total += reward
    assert ended
    assert total == pytest.approx(info["s"], abs=0.1)
    assert abs(observation[0]) > 3.0  # straight on in the first bend
    assert info["friction"] > 0.0


def test_a_standing_start_stands(tmp_path: Path) -> None:
    file = tmp_path / "standing.toml"
    speed = 'name = "standing"\n[speed]\nv_start = 0.0\n'
    text = speed + '[track]\nkind = "circle"\n[[zones]]\nstart = 0.0\nfriction = 0.8\n'
    file.write_text(text)
    environment = TrackEnvironment(str(file))
    _, info = environment.reset()
    assert info["x"][2] == 0.0


def test_an_episode_that_begins_in_a_bend_begins_with_its_yaw_rate() -> None:
    scenario = replace(load_scenario("random"), track=Track("circle", parameters={"radius": 20.0}))
    _, info = TrackEnvironment(scenario).reset()
    _, _, v_x, _, _, omega, delta = info["x"]
    assert omega == pytest.approx(v_x / 20.0, rel=0.01)
    assert delta == pytest.approx(2.4 / 20.0, rel=0.1)  # distance of the axles over the radius


def test_a_seed_makes_the_track() -> None:
    environment = TrackEnvironment("random")
    first, _ = environment.reset(seed=1)
    other, _ = environment.reset(seed=2)
    again, _ = environment.reset(seed=1)
    assert not np.array_equal(first, other)
    np.testing.assert_array_equal(first, again)


def test_a_seed_is_followed_by_new_episodes() -> None:
    environment = TrackEnvironment("random")
    own, _ = environment.reset()
    np.testing.assert_array_equal(own, environment.reset(seed=load_scenario("random").seed)[0])
    episodes = [environment.reset(seed=1)[0], environment.reset()[0], environment.reset()[0]]
    assert len({episode.tobytes() for episode in episodes}) == 3
    again = [environment.reset(seed=1)[0], environment.reset()[0], environment.reset()[0]]
    np.testing.assert_array_equal(episodes, again)


def test_delay_and_noise_of_the_scenario_act() -> None:
    plain = load_scenario("rounded-rectangle")
    deviations = Measurement(position=0.1, psi=0.05)
    environment = TrackEnvironment(replace(plain, measurement=deviations))
    observed = np.array([environment.reset(seed=seed)[0] for seed in range(200)])
    measured = np.std(observed[:, :2], axis=0)
    np.testing.assert_allclose(measured, [0.1, 0.05], rtol=0.2)  # four standard errors of 200
    assert np.ptp(observed[:, 2:6], axis=0).max() == 0.0
    _, info = environment.reset(seed=0)
    assert info["s"] == 0.0
    delayed = TrackEnvironment(replace(plain, actuator_delay=2))
    delayed.reset()
    steering = [delayed.step(np.array([0.0, 1.0]))[0][5] for _ in range(3)]
    assert steering[1] == 0.0
    assert steering[2] > 0.0


def test_what_concerns_the_controller_of_a_closed_loop_has_no_effect() -> None:
    plain = load_scenario("rounded-rectangle")
    steering = np.array([0.2, 0.1])

    def observed(scenario: Scenario) -> list[list[float]]:
        environment = TrackEnvironment(scenario)
        first, _ = environment.reset(seed=1)
        return [first.tolist(), environment.step(steering)[0].tolist()]

    changed = replace(
        plain,
        library="missing.safetensors",
        control={"cost": {"lateral": 3.0}},
        gate={"a_max": 1.0},
    )
    for speed in (
        replace(plain.speed, knows="nothing", risk=0.3, preview=False),
        replace(plain.speed, knows="here", friction=0.2, risk=0.05),
    ):
        assert observed(replace(changed, speed=speed)) == observed(plain)
    with pytest.raises(FileNotFoundError, match=r"missing\.safetensors"):
        TrackEnvironment(replace(changed, speed=replace(plain.speed, tyres=True)))


def test_the_ends_of_an_episode_are_python_bools() -> None:
    environment = TrackEnvironment("rounded-rectangle")
    environment.reset()
    _, _, terminated, truncated, _ = environment.step(CREEP)
    assert (type(terminated), type(truncated)) == (bool, bool)


def test_the_documents_example_drives(capsys: pytest.CaptureFixture[str]) -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    (example,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(example, {})  # noqa: S102 - the document's own code
    s, friction = map(float, capsys.readouterr().out.split())
    assert s > 3.0
    assert friction > 0.0


@pytest.mark.parametrize("dt", [0.0, -0.02, np.nan, np.inf])
def test_the_period_is_checked(dt: float) -> None:
    with pytest.raises(InvalidArgumentError, match="seconds for dt"):
        TrackEnvironment("rounded-rectangle", dt=dt)


def test_an_action_that_is_no_action_is_an_error() -> None:
    environment = TrackEnvironment("rounded-rectangle")
    environment.reset()
    for action in ([np.nan, 0.0], [0.0], [[0.0, 0.0]]):
        for given in (action, np.array(action)):
            with pytest.raises(InvalidArgumentError, match=r"an action of shape \(2,\)"):
                environment.step(given)


def test_an_action_may_be_a_list() -> None:
    actions: list[ArrayLike] = [CREEP, CREEP.tolist()]
    seen = [TrackEnvironment("rounded-rectangle").step(action)[0].tolist() for action in actions]
    assert seen[0] == seen[1]


OWN = """
import numpy as np
class Car:
    def reset(self, x): self.x = x
    def step(self, u, dt, friction): self.x = self.x + {change}
    @property
    def state(self): return self.x
"""


def test_only_the_loss_of_the_vehicle_ends_an_episode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    track = '[track]\nkind = "rounded-rectangle"\n[[zones]]\nstart = 0.0\nfriction = 1.0\n'
    for module, change in {"lost_car": "np.nan", "wrong_car": "np.zeros((2, 7))"}.items():
        (tmp_path / f"{module}.py").write_text(OWN.format(change=change))
        own = f'name = "own"\nplant = "{module}:Car"\n{track}'
        (tmp_path / f"{module}.toml").write_text(own)
    environment = TrackEnvironment("lost_car.toml")
    first, _ = environment.reset()
    observation, reward, ended, _, _ = environment.step(CREEP)
    assert (ended, reward) == (True, 0.0)
    np.testing.assert_array_equal(observation, first)
    environment = TrackEnvironment("wrong_car.toml")
    environment.reset()
    with pytest.raises(PlantError, match=r"has the shape \(2, 7\)"):
        environment.step(CREEP)
