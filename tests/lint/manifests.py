#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Kubernetes' manifests and compose.yaml fit together, and fit the programs:
what is named is there (ports, volumes, secrets, labels, services), fields are
those of the kinds, options are those that the programs know, and nothing runs as
root. No schema of the API is a Debian package, so this is a check of the structure.

    manifests.py BUILD [ROOT]

Exits with 77 without Debian's python3-yaml.
"""
from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

try:
    import yaml
except ImportError:
    print("SKIPPED: there is no python3-yaml", file=sys.stderr)
    sys.exit(77)

VERSIONS = {
    "Service": "v1",
    "ConfigMap": "v1",
    "Namespace": "v1",
    "ServiceAccount": "v1",
    "PersistentVolumeClaim": "v1",
    "Deployment": "apps/v1",
    "StatefulSet": "apps/v1",
    "DaemonSet": "apps/v1",
    "PodDisruptionBudget": "policy/v1",
    "NetworkPolicy": "networking.k8s.io/v1",
    "Ingress": "networking.k8s.io/v1",
    "HorizontalPodAutoscaler": "autoscaling/v2",
}
POD = {
    "affinity", "automountServiceAccountToken", "containers", "enableServiceLinks", "imagePullSecrets", "initContainers",
    "nodeSelector", "priorityClassName", "restartPolicy", "securityContext", "serviceAccountName",
    "terminationGracePeriodSeconds", "tolerations", "topologySpreadConstraints", "volumes",
}
CONTAINER = {
    "args", "command", "env", "envFrom", "image", "imagePullPolicy", "lifecycle", "livenessProbe", "name", "ports",
    "readinessProbe", "resources", "securityContext", "startupProbe", "terminationMessagePolicy", "volumeMounts",
    "workingDir",
}
WORKLOAD = {
    "minReadySeconds", "podManagementPolicy", "progressDeadlineSeconds", "replicas", "revisionHistoryLimit", "selector",
    "serviceName", "strategy", "template", "updateStrategy", "volumeClaimTemplates",
}
COMPOSE_SERVICE = {
    "build", "cap_drop", "command", "cpus", "depends_on", "entrypoint", "environment", "healthcheck", "image",
    "mem_limit", "networks", "pids_limit", "ports", "profiles", "read_only", "restart", "secrets", "security_opt",
    "stop_grace_period", "stop_signal", "tmpfs", "ulimits", "user", "volumes", "working_dir",
}

problems: list[str] = []


def check(right: bool, where: str, words: str) -> None:
    if not right:
        problems.append(f"{where}: {words}")


def only(where: str, mapping: dict, known: set[str]) -> None:
    for key in sorted(set(mapping) - known):
        problems.append(f"{where}: no field '{key}'")


class Programs:
    """Which options each of our images' programs has."""

    def __init__(self, build: Path) -> None:
        self.build = build
        self._options: dict[str, set[str]] = {}

    def options(self, image: str) -> set[str] | None:
        name = image.split("/")[-1].split(":")[0]
        program = {"groundlock": "groundlock-server", "groundlock-dashboard": "groundlock-dashboard"}.get(name)
        if program is None:
            return None
        if program not in self._options:
            told = subprocess.run(
                [self.build / "bin" / program, "--help"], check=True, capture_output=True, text=True).stdout
            self._options[program] = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", told))
        return self._options[program]

    def check(self, where: str, image: str, arguments: list[str]) -> None:
        known = self.options(image)
        for argument in arguments if known is not None else []:
            option = str(argument).split("=")[0]
            if option.startswith("--"):
                check(option in known, where, f"the program has no option {option}")


def kubernetes(folder: Path, programs: Programs) -> int:
    kustomization = yaml.safe_load((folder / "kustomization.yaml").read_text())
    files = kustomization["resources"]
    check(
        set(files) == {p.name for p in folder.glob("*.yaml")} - {"kustomization.yaml"},
        "kustomization.yaml", f"resources are {files}, and other files are in the folder")
    documents = [
        (name, d) for name in files for d in yaml.safe_load_all((folder / name).read_text()) if d is not None]
    explained = (folder / "kustomization.yaml").read_text()

    workloads: dict[str, dict] = {}
    for name, d in documents:
        where = f"{name}: {d.get('kind')} {d.get('metadata', {}).get('name')}"
        check(VERSIONS.get(d.get("kind")) == d.get("apiVersion"), where, f"apiVersion {d.get('apiVersion')}")
        check(bool(re.fullmatch(r"[a-z0-9]([-a-z0-9]{0,61}[a-z0-9])?", d["metadata"]["name"])), where, "its name")
        if d["kind"] in ("Deployment", "StatefulSet", "DaemonSet"):
            workloads[d["metadata"]["name"]] = d
            workload(where, d, programs, explained)
    names = [(d["kind"], d["metadata"]["name"]) for _, d in documents]
    check(len(names) == len(set(names)), "kubernetes", "two resources have one name")

    def pods_of(labels: dict) -> list[dict]:
        return [
            w["spec"]["template"]["spec"] for w in workloads.values()
            if labels.items() <= w["spec"]["template"]["metadata"]["labels"].items()
        ]

    def ports_of(pods: list[dict]) -> set:
        ports = [p for pod in pods for c in pod["containers"] for p in c.get("ports", [])]
        return {p.get("name") for p in ports} | {p["containerPort"] for p in ports}

    for name, d in documents:
        where = f"{name}: {d['kind']} {d['metadata']['name']}"
        spec = d.get("spec", {})
        if d["kind"] == "Service":
            pods = pods_of(spec["selector"])
            check(bool(pods), where, "selects no pods")
            for port in spec["ports"]:
                target = port.get("targetPort", port["port"])
                check(target in ports_of(pods), where, f"no container has the port {target}")
        elif d["kind"] == "NetworkPolicy":
            pods = pods_of(spec["podSelector"].get("matchLabels", {}))
            check(bool(pods), where, "selects no pods")
            for rule in spec.get("ingress", []):
                for port in rule.get("ports", []):
                    check(port["port"] in ports_of(pods), where, f"no container has the port {port['port']}")
            for rule in spec.get("ingress", []) + spec.get("egress", []):
                for peer in rule.get("from", []) + rule.get("to", []):
                    labels = peer.get("podSelector", {}).get("matchLabels", {})
                    if labels and "namespaceSelector" not in peer:
                        check(bool(pods_of(labels)), where, f"no pods have the labels {labels}")
        elif d["kind"] == "PodDisruptionBudget":
            check(bool(pods_of(spec["selector"]["matchLabels"])), where, "selects no pods")
            check(len({"minAvailable", "maxUnavailable"} & set(spec)) == 1, where, "one of minAvailable, maxUnavailable")
        elif d["kind"] == "HorizontalPodAutoscaler":
            target = spec["scaleTargetRef"]
            other = workloads.get(target["name"])
            check(other is not None and other["kind"] == target["kind"], where, f"there is no {target}")
            check(1 <= spec.get("minReplicas", 1) <= spec["maxReplicas"], where, "minReplicas, maxReplicas")
            check(bool(spec.get("metrics")), where, "scales by nothing")
    return len(documents)


def workload(where: str, d: dict, programs: Programs, explained: str) -> None:
    spec = d["spec"]
    only(where, spec, WORKLOAD)
    template = spec["template"]
    check(
        spec["selector"]["matchLabels"].items() <= template["metadata"]["labels"].items(), where,
        "its selector does not select its own pods")
    pod = template["spec"]
    only(where, pod, POD)
    volumes = {v["name"] for v in pod.get("volumes", [])}
    volumes |= {c["metadata"]["name"] for c in spec.get("volumeClaimTemplates", [])}
    mounted: set[str] = set()
    for container in pod["containers"] + pod.get("initContainers", []):
        at = f"{where}, {container['name']}"
        only(at, container, CONTAINER)
        ports = {p.get("name") for p in container.get("ports", [])}
        ports |= {p["containerPort"] for p in container.get("ports", [])}
        for kind in ("startupProbe", "readinessProbe", "livenessProbe"):
            probe = container.get(kind, {})
            for how in ("httpGet", "tcpSocket", "grpc"):
                if how in probe:
                    check(probe[how]["port"] in ports, at, f"{kind} asks a port that the container has not")
        for mount in container.get("volumeMounts", []):
            mounted.add(mount["name"])
            check(mount["name"] in volumes, at, f"mounts '{mount['name']}', which is no volume")
        ours = programs.options(container["image"]) is not None
        programs.check(at, container["image"], container.get("args", []))
        if ours:
            security = container.get("securityContext", {})
            check(security.get("allowPrivilegeEscalation") is False, at, "may become another user")
            check(security.get("capabilities", {}).get("drop") == ["ALL"], at, "keeps capabilities")
            check(pod.get("securityContext", {}).get("runAsNonRoot") is True, at, "may run as root")
            check("memory" in container.get("resources", {}).get("limits", {}), at, "has no limit of memory")
            for option, port in (("--listen", None), ("--metrics", None)):
                for argument in container.get("args", []):
                    if argument.startswith(f"{option}="):
                        port = int(argument.rpartition(":")[2])
                        check(port in ports, at, f"{option} opens {port}, which is no port of the container")
        for variable in container.get("env", []):
            secret = variable.get("valueFrom", {}).get("secretKeyRef")
            if secret:
                check(f" {secret['name']}" in explained, at, f"nobody says how to make the secret {secret['name']}")
    check(volumes == mounted, where, f"volumes {sorted(volumes ^ mounted)} are mounted nowhere")
    for volume in pod.get("volumes", []):
        secret = volume.get("secret", {}).get("secretName")
        if secret:
            check(f" {secret}" in explained, where, f"nobody says how to make the secret {secret}")


def compose(path: Path, programs: Programs) -> int:
    d = yaml.safe_load(path.read_text())
    services = d["services"]
    dockerfile = (path.parent / "Dockerfile").read_text()
    targets = set(re.findall(r"^FROM \S+ AS (\w+)", dockerfile, re.M))
    for name, service in services.items():
        where = f"compose.yaml: {name}"
        only(where, service, COMPOSE_SERVICE)
        for other in service.get("depends_on", {}):
            check(other in services, where, f"depends on '{other}', which is not there")
            condition = service["depends_on"][other] if isinstance(service["depends_on"], dict) else {}
            if condition.get("condition") == "service_healthy":
                healthy = "healthcheck" in services[other] or "build" in services[other]
                check(healthy, where, f"waits for the health of {other}, which has none")
        for secret in service.get("secrets", []):
            secret = secret if isinstance(secret, str) else secret["source"]
            check(secret in d.get("secrets", {}), where, f"no secret '{secret}'")
        for volume in service.get("volumes", []):
            source = str(volume).split(":")[0]
            check(source.startswith((".", "/")) or source in d.get("volumes", {}), where, f"no volume '{source}'")
        command = service.get("command", [])
        check(isinstance(command, list), where, "its command is no list")
        programs.check(where, service["image"], command)
        for argument in command:
            for file in re.findall(r"/run/secrets/(\S+)", str(argument)):
                check(file in service.get("secrets", []), where, f"is told of the secret {file}, and not given it")
        if "build" in service:
            check(service["build"].get("target") in targets, where, "builds a target that the Dockerfile has not")
            context = (path.parent / service["build"]["context"]).resolve()
            check((context / service["build"]["dockerfile"]).is_file(), where, "its Dockerfile is not there")
            check(service.get("cap_drop") == ["ALL"], where, "keeps capabilities")
            check("no-new-privileges:true" in service.get("security_opt", []), where, "may gain privileges")
        for port in service.get("ports", []):
            check(str(port).startswith("127.0.0.1:"), where, f"publishes {port} to everybody")
    return len(services)


def main() -> int:
    build = Path(sys.argv[1]).absolute()
    root = Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).resolve().parents[2]
    programs = Programs(build)
    resources = kubernetes(root / "deploy" / "kubernetes", programs)
    services = compose(root / "deploy" / "docker" / "compose.yaml", programs)
    for problem in problems:
        print(f"manifests: {problem}", file=sys.stderr)
    if not problems:
        print(f"manifests: {resources} resources of Kubernetes and {services} services fit together")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
