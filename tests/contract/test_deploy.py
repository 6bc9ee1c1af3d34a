"""The files of `deploy` are valid, agree with each other, and start a replica and a router."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import tomllib
import urllib.request
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import zenoh

from egp_service import VehicleClient, VehicleParameters, shipped
from egp_service._core import Server
from egp_service.control.endpoints import free_endpoint, free_port
from egp_service.control.toml_text import dumps

if TYPE_CHECKING:
    from collections.abc import Iterator

yaml = pytest.importorskip("yaml", reason="comes with the extra dev")
kubernetes_validate = pytest.importorskip("kubernetes_validate", reason="comes with the extra dev")

ROOT = Path(__file__).parents[2]
MANIFESTS = ROOT / "deploy/kubernetes"
COMPOSE = yaml.safe_load((ROOT / "deploy/compose.yaml").read_text(encoding="utf-8"))
KUSTOMIZATION = yaml.safe_load((MANIFESTS / "kustomization.yaml").read_text(encoding="utf-8"))
RESOURCES = {
    (resource["kind"], resource["metadata"]["name"]): resource
    for file in KUSTOMIZATION["resources"]
    for resource in yaml.safe_load_all((MANIFESTS / file).read_text(encoding="utf-8"))
}
CONFIGURATION = tomllib.loads((MANIFESTS / "service.toml").read_text(encoding="utf-8"))
# The schemas of the newest version of Kubernetes that the package has.
VERSION = kubernetes_validate.latest_version()
KEY = "5a" * 32


def pod(kind: str, name: str) -> dict[str, Any]:
    """Give the pods' specification of a workload."""
    spec: dict[str, Any] = RESOURCES[kind, name]["spec"]["template"]["spec"]
    return spec


REPLICA = pod("Deployment", "egp-server")
ROUTER = pod("StatefulSet", "egp-router")
(SERVER,) = REPLICA["containers"]
(ZENOHD,) = ROUTER["containers"]


@pytest.mark.parametrize("resource", RESOURCES, ids="/".join)
def test_manifests_fit_the_schemas(resource: tuple[str, str]) -> None:
    kubernetes_validate.validate(RESOURCES[resource], VERSION, strict=True)


def test_the_schemas_find_a_mistake() -> None:
    broken = json.loads(json.dumps(RESOURCES["Deployment", "egp-server"]))
    broken["spec"]["template"]["spec"]["containers"][0]["readinessProb"] = {}
    with pytest.raises(kubernetes_validate.ValidationError, match="readinessProb"):
        kubernetes_validate.validate(broken, VERSION, strict=True)


def test_every_manifest_is_listed() -> None:
    generated = {name for each in KUSTOMIZATION["configMapGenerator"] for name in each["files"]}
    listed = {*KUSTOMIZATION["resources"], *generated, "kustomization.yaml"}
    assert listed == {path.name for path in MANIFESTS.iterdir()}


@pytest.mark.skipif(shutil.which("kubectl") is None, reason="kubectl is not installed")
def test_kustomize_renders_the_manifests() -> None:
    command = ["kubectl", "kustomize", str(MANIFESTS)]  # needs no cluster
    text = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    rendered = list(yaml.safe_load_all(text))
    assert len(rendered) == len(RESOURCES) + len(KUSTOMIZATION["configMapGenerator"])
    for resource in rendered:
        kubernetes_validate.validate(resource, VERSION, strict=True)


def test_selectors_choose_the_pods() -> None:
    for kind, name in (("Deployment", "egp-server"), ("StatefulSet", "egp-router")):
        workload = RESOURCES[kind, name]["spec"]
        labels = workload["template"]["metadata"]["labels"]
        assert workload["selector"]["matchLabels"] == labels
        budget = RESOURCES["PodDisruptionBudget", name]["spec"]
        assert budget["selector"]["matchLabels"] == labels
        for spread in workload["template"]["spec"]["topologySpreadConstraints"]:
            assert spread["labelSelector"]["matchLabels"] == labels
    routers = RESOURCES["StatefulSet", "egp-router"]["spec"]
    for name in ("egp", routers["serviceName"]):
        service = RESOURCES["Service", name]["spec"]
        assert service["selector"] == routers["template"]["metadata"]["labels"]
    policy = RESOURCES["NetworkPolicy", "egp-server"]["spec"]
    template = RESOURCES["Deployment", "egp-server"]["spec"]["template"]
    assert policy["podSelector"]["matchLabels"] == template["metadata"]["labels"]


def test_ports_names_and_times_agree() -> None:
    (http,) = SERVER["ports"]
    assert CONFIGURATION["http"].endswith(f":{http['containerPort']}")
    template = RESOURCES["Deployment", "egp-server"]["spec"]["template"]
    annotations = template["metadata"]["annotations"]
    assert annotations["prometheus.io/port"] == str(http["containerPort"])
    assert probes().keys() == {"startupProbe", "livenessProbe", "readinessProbe"}
    assert all(probe["port"] == http["name"] for probe in probes().values())
    assert REPLICA["terminationGracePeriodSeconds"] > 2 * CONFIGURATION["drain_ms"] / 1000
    (port,) = ZENOHD["ports"]
    routers = RESOURCES["StatefulSet", "egp-router"]["spec"]
    expected = [
        f"tcp/egp-router-{index}.{routers['serviceName']}:{port['containerPort']}"
        for index in range(routers["replicas"])
    ]
    assert json.loads(CONFIGURATION["zenoh"]["connect/endpoints"]) == expected
    config = zenoh.Config.from_file(str(MANIFESTS / "router.json5"))
    assert json.loads(config.get_json("connect/endpoints")) == expected
    # Files of the configuration are in volumes that are mounted.
    mounted = [mount["mountPath"] for mount in SERVER["volumeMounts"]]
    for file in (CONFIGURATION["library"], CONFIGURATION["vehicle_keys"], SERVER["args"][1]):
        assert str(Path(file).parent) in mounted


def probes() -> dict[str, dict[str, Any]]:
    """HTTP requests of the replica's probes, by the probes' names."""
    return {name: probe["httpGet"] for name, probe in SERVER.items() if name.endswith("Probe")}


def test_options_of_the_server_exist() -> None:
    source = (ROOT / "rust/service/src/bin/egp-server.rs").read_text(encoding="utf-8")
    arguments = source.partition("struct Arguments {")[2].partition("\n}")[0]
    options = {
        name.replace("_", "-") for name in re.findall(r"^    (\w+): ", arguments, re.MULTILINE)
    }
    used = [
        *SERVER["args"],
        *(
            arg
            for name in ("replica-1", "replica-2")
            for arg in COMPOSE["services"][name]["command"]
        ),
        *re.findall(r'"(--[\w-]+)"', (ROOT / "deploy/Dockerfile").read_text(encoding="utf-8")),
    ]
    named = {arg[2:].partition("=")[0] for arg in used if arg.startswith("--")}
    assert named <= options, f"egp-server has no {named - options}"
    assert {"config", "replica"} <= named


def test_the_routers_have_the_defaults_of_the_service() -> None:
    setting = r'\(\s*"([\w/]+)",\s*(?:r#)?"(.*?)"#?,?\s*\)'
    router = zenoh.Config.from_file(str(MANIFESTS / "router.json5"))
    compared = set()
    for file in ("session/src/lib.rs", "service/src/zenoh_settings.rs"):
        source = (ROOT / "rust" / file).read_text(encoding="utf-8")
        defaults = source.partition("const DEFAULTS: ")[2].partition("\n];")[0]
        found = re.findall(setting, defaults, re.DOTALL)
        assert len(found) == defaults.count("\n    (")
        for key, value in found:
            expected = zenoh.Config()
            expected.insert_json5(key, value)
            if key != "listen/endpoints":
                assert router.get_json(key) == expected.get_json(key), key
            compared.add(key)
    assert {"qos/network", "transport/unicast/accept_timeout", "connect/retry"} <= compared


def test_the_loader_fills_the_claim_that_the_replicas_read() -> None:
    loader = yaml.safe_load((ROOT / "deploy/loader.yaml").read_text(encoding="utf-8"))
    kubernetes_validate.validate(loader, VERSION, strict=True)
    (filled,) = loader["spec"]["volumes"]
    (read,) = (each for each in REPLICA["volumes"] if each["name"] == "library")
    claim = filled["persistentVolumeClaim"]
    assert read["persistentVolumeClaim"] == claim | {"readOnly": True}
    modes = RESOURCES["PersistentVolumeClaim", claim["claimName"]]["spec"]["accessModes"]
    assert modes == ["ReadWriteMany"]
    (container,) = loader["spec"]["containers"]
    (mount,) = container["volumeMounts"]
    text = (ROOT / "docs/deploying.md").read_text(encoding="utf-8")
    path = f"{mount['mountPath']}/{Path(CONFIGURATION['library']).name}"
    assert f"egp/{loader['metadata']['name']}:{path}" in text


def test_the_compose_file_publishes_to_this_machine_only() -> None:
    services = COMPOSE["services"]
    assert set(services) == {"router", "replica-1", "replica-2"}
    for service in services.values():
        assert all(port.startswith("127.0.0.1:") for port in service["ports"])
    compose = tomllib.loads((ROOT / "deploy/compose.toml").read_text(encoding="utf-8"))
    for name in ("replica-1", "replica-2"):
        (port,) = services[name]["ports"]
        assert compose["http"].endswith(f":{port.split(':')[-1]}")
        volumes = [volume.rsplit(":", 2) for volume in services[name]["volumes"]]
        mounted = {inside: outside for outside, inside, _ in volumes}
        assert all(rights == "ro" for _, _, rights in volumes)
        folder = str(Path(compose["library"]).parent)
        assert mounted.keys() == {"/etc/egp/service.toml", folder}
        # A file that is mounted by itself stays the old one when a new one takes its name.
        default = re.fullmatch(r"\$\{LIBRARY_FOLDER:-(.*)\}", mounted[folder])
        assert default
        assert (ROOT / "deploy" / default[1] / Path(compose["library"]).name).is_file()
        stated = f"{folder}/${{LIBRARY:-{Path(compose['library']).name}}}"
        assert f"--library={stated}" in services[name]["command"]
    names = [services[name]["command"][-1] for name in ("replica-1", "replica-2")]
    assert names == ["--replica=replica-1", "--replica=replica-2"]
    build = services["replica-1"]["build"]
    assert (ROOT / "deploy" / build["context"] / build["dockerfile"]).is_file()
    assert services["replica-1"]["image"] == SERVER["image"]
    assert services["router"]["image"] == ZENOHD["image"]


def test_docker_reads_the_compose_file() -> None:
    docker = shutil.which("docker")
    if docker is None or subprocess.run([docker, "compose", "version"], check=False).returncode:
        pytest.skip("docker compose is not installed")
    file = str(ROOT / "deploy/compose.yaml")
    subprocess.run([docker, "compose", "--file", file, "config", "--quiet"], check=True)


@pytest.fixture
def router() -> Iterator[str]:
    """Run a router with the configuration of the ConfigMap, on an address of this machine."""
    endpoint = free_endpoint()
    config = zenoh.Config.from_file(str(MANIFESTS / "router.json5"))
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("connect/endpoints", "[]")
    with zenoh.open(config):
        yield endpoint


@pytest.mark.parametrize("file", ["kubernetes/service.toml", "compose.toml"])
def test_a_replica_waits_for_its_router_without_an_end(file: str) -> None:
    written = tomllib.loads((ROOT / "deploy" / file).read_text(encoding="utf-8"))
    assert json.loads(written["zenoh"]["connect/timeout_ms"]) == -1


@pytest.mark.parametrize("file", ["kubernetes/service.toml", "compose.toml"])
def test_a_vehicle_reaches_a_replica_through_a_router(
    tmp_path: Path, router: str, file: str
) -> None:
    """Replica and router have the configurations of `deploy` but for addresses and files."""
    keys, http = tmp_path / "vehicles.keys", free_port()
    keys.write_text(f"default/car-1 {KEY}\n", encoding="utf-8")
    written = tomllib.loads((ROOT / "deploy" / file).read_text(encoding="utf-8"))
    sealed = "vehicle_keys" in written
    config = written | {
        "library": str(shipped.DEMO_LIBRARY),
        **({"vehicle_keys": str(keys)} if sealed else {}),
        "http": f"127.0.0.1:{http}",
        "drain_ms": 50,
        "workers": 1,
        "zenoh": written["zenoh"] | {"connect/endpoints": json.dumps([router])},
    }
    gate = VehicleParameters.commonroad(1).gate_limits()
    with (
        Server(dumps(config)),
        VehicleClient.connect(
            [router], vehicle="car-1", gate=gate, key_file=keys if sealed else None
        ) as vehicle,
    ):
        for probe in probes().values():
            with urllib.request.urlopen(f"http://127.0.0.1:{http}{probe['path']}") as answer:
                assert answer.status == 200
        s = 15.0 * vehicle.dt * np.arange(vehicle.horizon + 1)
        zero = np.zeros_like(s)
        x = np.array([0.0, 0.3, 15.0, 0.0, 0.0, 0.0, 0.0])
        reference = np.column_stack([s, zero, zero + 15.0, zero])
        assert vehicle.step(x, reference, deadline=5.0).status == "solved"
        with urllib.request.urlopen(f"http://127.0.0.1:{http}/metrics") as answer:
            assert 'egp_requests_total{outcome="solved"} 1\n' in answer.read().decode()


def test_the_collector_reads_traces() -> None:
    """Every part that is defined is used, and every part that is used is defined."""
    collector = yaml.safe_load((ROOT / "deploy/collector.yaml").read_text(encoding="utf-8"))
    service = collector["service"]
    (pipeline,) = service["pipelines"].values()
    for kind in ("receivers", "exporters"):
        assert set(pipeline[kind]) == collector[kind].keys()
    assert set(service["extensions"]) == collector["extensions"].keys()
    receiver = collector["receivers"]["otlp_json_file"]
    assert receiver["storage"] in collector["extensions"]
    assert all(pattern.endswith(".jsonl") for pattern in receiver["include"])
