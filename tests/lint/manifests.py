#!/usr/bin/python3
# SPDX-License-Identifier: Apache-2.0
"""Whether what deploy/ has for Kubernetes, Compose and systemd holds together.

    tests/lint/manifests.py [--bin FOLDER]

Kubernetes' objects must be as its API has them, every name that one manifest has of
another's must be there, whoever runs must be confined, and every option must be one
that the program knows (with --bin).
"""
import argparse
import copy
import pathlib
import re
import subprocess
import sys

import kubernetes_schema
import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
failures = []


def expect(holds, what):
    if not holds:
        failures.append(what)


def load(path):
    return [d for d in yaml.safe_load_all(path.read_text(encoding="utf-8")) if d]


def options_of(program):
    """The options in a program's help."""
    text = subprocess.run([program, "--help"], capture_output=True, text=True, check=True).stdout
    return set(re.findall(r"--[a-z][a-z0-9-]+", text))


def matches(selector, labels):
    return all(labels.get(key) == value for key, value in selector.items())


def pod_templates(objects):
    return {
        (o["kind"], o["metadata"]["name"]): o["spec"]["template"]
        for o in objects
        if o["kind"] in ("Deployment", "StatefulSet")
    }


def check_containers(name, template):
    """Ports, volumes and probes of one pod. Returns the names of its ports."""
    spec = template["spec"]
    volumes = {v["name"] for v in spec.get("volumes", [])}
    ports = {}
    for container in spec["containers"]:
        where = f"{name}/{container['name']}"
        for port in container.get("ports", []):
            ports[port["name"]] = port["containerPort"]
        if name[0] == "Deployment":
            for mount in container.get("volumeMounts", []):
                expect(mount["name"] in volumes, f"{where}: no volume {mount['name']}")
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
            http = container.get(probe, {}).get("httpGet")
            if http:
                expect(http["port"] in ports, f"{where}: {probe} asks an unknown port")
    return ports


def check_confinement(name, template):
    spec = template["spec"]
    pod = spec.get("securityContext", {})
    expect(pod.get("runAsNonRoot"), f"{name}: may run as root")
    expect(pod.get("seccompProfile", {}).get("type") == "RuntimeDefault", f"{name}: no seccomp")
    expect(spec.get("automountServiceAccountToken") is False, f"{name}: has Kubernetes' token")
    for container in spec["containers"]:
        own = container.get("securityContext", {})
        where = f"{name}/{container['name']}"
        expect(own.get("allowPrivilegeEscalation") is False, f"{where}: may gain privileges")
        expect(own.get("readOnlyRootFilesystem"), f"{where}: writes its own files")
        expect(own.get("capabilities", {}).get("drop") == ["ALL"], f"{where}: has capabilities")
        expect("memory" in container.get("resources", {}).get("limits", {}), f"{where}: no memory limit")


def check_policies(objects, templates):
    """Each pod is under a policy for both directions."""
    policies = [o for o in objects if o["kind"] == "NetworkPolicy"]
    for name, template in templates.items():
        labels = template["metadata"]["labels"]
        mine = [p for p in policies if matches(p["spec"]["podSelector"].get("matchLabels", {}), labels)]
        types = {t for p in mine for t in p["spec"]["policyTypes"]}
        expect(types == {"Ingress", "Egress"}, f"{name}: no network policy for {types}")
        ports = {p["name"]: p["containerPort"] for c in template["spec"]["containers"] for p in c.get("ports", [])}
        for policy in mine:
            for rule in policy["spec"].get("ingress", []):
                for port in rule.get("ports", []):
                    expect(
                        port["port"] in ports or port["port"] in ports.values(),
                        f"{policy['metadata']['name']}: {name} has no port {port['port']}",
                    )


def check_schemas(objects):
    for o in objects:
        for mismatch in kubernetes_schema.mismatches(o):
            expect(False, f"kubernetes: {o['metadata']['name']}: {mismatch}")
    # A look that finds nothing anywhere would find nothing here, either.
    deployment = next(o for o in objects if o["kind"] == "Deployment")

    def broken(change):
        other = copy.deepcopy(deployment)
        change(other["spec"]["template"]["spec"]["containers"][0])
        return kubernetes_schema.mismatches(other)

    for what, change in {
        "a field that there is not": lambda container: container.update(livenessprobe={}),
        "a number for words": lambda container: container["env"][0].update(value=1),
        "words for a number": lambda container: container["ports"][0].update(containerPort="50551"),
        "a field left out": lambda container: container.pop("name"),
        "a list for an object": lambda container: container.update(resources=[]),
    }.items():
        expect(len(broken(change)) == 1, f"kubernetes: {what} is not found")


def check_kubernetes(known):
    folder = ROOT / "deploy/kubernetes"
    kustomization = load(folder / "kustomization.yaml")[0]
    objects = [o for name in kustomization["resources"] for o in load(folder / name)]
    for o in objects:
        expect({"apiVersion", "kind", "metadata"} <= o.keys(), f"an object of {folder} is incomplete")
    check_schemas(objects)
    templates = pod_templates(objects)
    expect(("Deployment", "groundlock") in templates, "kubernetes: no Deployment groundlock")
    for o in objects:
        kind, name = o["kind"], o["metadata"]["name"]
        if kind in ("Deployment", "StatefulSet"):
            labels = o["spec"]["template"]["metadata"]["labels"]
            expect(matches(o["spec"]["selector"]["matchLabels"], labels), f"{kind} {name}: selects none of its own")
        if kind in ("Service", "PodDisruptionBudget"):
            selector = o["spec"]["selector"]
            selector = selector.get("matchLabels", selector)
            found = [t for t in templates.values() if matches(selector, t["metadata"]["labels"])]
            expect(len(found) == 1, f"{kind} {name}: selects {len(found)} kinds of pods")
            for port in o["spec"].get("ports", []) if found else []:
                names = {p["name"] for c in found[0]["spec"]["containers"] for p in c.get("ports", [])}
                target = port.get("targetPort", port["name"])
                expect(target in names, f"Service {name}: no port {target}")
        if kind == "HorizontalPodAutoscaler":
            target = o["spec"]["scaleTargetRef"]
            expect((target["kind"], target["name"]) in templates, f"{kind} {name}: scales nothing")
            scaled = next(d for d in objects if d["kind"] == target["kind"] and d["metadata"]["name"] == target["name"])
            expect("replicas" not in scaled["spec"], f"{kind} {name}: the Deployment says how many, too")
            expect(o["spec"]["minReplicas"] >= 2, f"{kind} {name}: one server is none while it restarts")
            metric = o["spec"]["metrics"][0]["pods"]["metric"]["name"]
            rules = load(folder / "prometheus-adapter.yaml")[0]["rules"]
            expect(any(r["name"]["as"] == metric for r in rules), f"{kind} {name}: nobody makes {metric}")
            exposed = (ROOT / "server/app/metrics_exposer.cc").read_text(encoding="utf-8")
            for rule in rules:
                for used in set(re.findall(r"groundlock_[a-z_]+?(?=_(?:sum|count)\{)", rule["metricsQuery"])):
                    expect(f'"{used}"' in exposed, f"prometheus-adapter: the server has no {used}")
    for name, template in templates.items():
        check_containers(name, template)
    check_confinement("Deployment groundlock", templates["Deployment", "groundlock"])
    check_policies(objects, templates)
    affinity = templates["Deployment", "groundlock"]["spec"]["affinity"]["podAntiAffinity"]
    term = affinity["preferredDuringSchedulingIgnoredDuringExecution"][0]["podAffinityTerm"]
    labels = templates["Deployment", "groundlock"]["metadata"]["labels"]
    expect(matches(term["labelSelector"]["matchLabels"], labels), "anti-affinity: of other pods")
    # A secret that is used is one whose making is told.
    told = (folder / "kustomization.yaml").read_text(encoding="utf-8")
    text = "\n".join((folder / f).read_text(encoding="utf-8") for f in kustomization["resources"])
    for secret in set(re.findall(r"secretName: (\S+)", text)):
        expect(f" {secret} " in told, f"secret {secret}: nobody is told how to make it")
    arguments = templates["Deployment", "groundlock"]["spec"]["containers"][0]["args"]
    check_arguments("kubernetes", arguments, known.get("groundlock-server"))


def check_arguments(where, arguments, known):
    for argument in arguments:
        expect(known is None or argument.split("=")[0] in known, f"{where}: no option {argument}")


def check_compose(known):
    path = ROOT / "deploy/docker/compose.yaml"
    compose = load(path)[0]
    text = path.read_text(encoding="utf-8")
    for name, service in compose["services"].items():
        for secret in service.get("secrets", []):
            expect(secret in compose["secrets"], f"compose: {name}: no secret {secret}")
        for needed in service.get("depends_on", []):
            expect(needed in compose["services"], f"compose: {name}: no service {needed}")
        for volume in service.get("volumes", []):
            expect(volume.split(":")[0] in compose["volumes"], f"compose: {name}: no volume {volume}")
        for used in re.findall(r"/run/secrets/([a-z.]+)", " ".join(service.get("command", []))):
            expect(used in service["secrets"], f"compose: {name}: {used} is not given to it")
        if name == "postgres":
            continue
        for key in ("read_only", "cap_drop", "security_opt", "mem_limit", "pids_limit"):
            expect(service.get(key), f"compose: {name}: no {key}")
        for port in service["ports"]:
            expect(port.startswith("127.0.0.1:"), f"compose: {name}: {port} is open to everybody")
        check_arguments(f"compose: {name}", service["command"], known.get(f"groundlock-{name}"))
    for name, secret in compose["secrets"].items():
        expect(name in text.split("services:")[0] or name.startswith(("ca.", "server.")),
               f"compose: nobody is told how to make {secret['file']}")
    # The two must not be one identity.
    files = {name: [a for a in compose["services"][name]["command"] if a.startswith("--token-file")]
             for name in ("server", "dashboard")}
    expect(files["server"] != files["dashboard"] and files["dashboard"], "compose: the dashboard has no token of its own")


def check_systemd(known):
    for program in ("groundlock-server", "groundlock-dashboard"):
        text = (ROOT / f"deploy/systemd/{program}.service").read_text(encoding="utf-8")
        for line in ("NoNewPrivileges=yes", "ProtectSystem=strict", "MemoryMax=", "SystemCallFilter=", "DynamicUser=yes",
                     "LoadCredential="):
            expect(line in text, f"{program}.service: no {line}")
        ours = "\n".join(line for line in text.splitlines() if "systemctl" not in line)
        used = re.findall(r"(?<= )--[a-z][a-z-]+", ours)
        check_arguments(f"{program}.service", used, known.get(program))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--bin", type=pathlib.Path)
    options = parser.parse_args()
    known = {}
    if options.bin:
        known = {p: options_of(options.bin / p) for p in ("groundlock-server", "groundlock-dashboard")}
    check_kubernetes(known)
    check_compose(known)
    check_systemd(known)
    for failure in failures:
        print(f"manifests: {failure}", file=sys.stderr)
    if failures:
        return 1
    print("manifests: all that they name is there")
    return 0


if __name__ == "__main__":
    sys.exit(main())
