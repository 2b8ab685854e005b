# SPDX-License-Identifier: Apache-2.0
"""Kubernetes' manifests against the schemas of its API.

Debian has them as the classes of python3-kubernetes, which are generated from the
API's own description: every field's name and type, which ones must be there, and
the values of some. They are of Kubernetes 1.22. What later became stable without
a change is looked for under the name that it had there.
"""
import re

import kubernetes.client

EARLIER_NAMES = {("autoscaling/v2", "HorizontalPodAutoscaler"): "V2beta2HorizontalPodAutoscaler"}
PRIMITIVES = {"str": str, "int": int, "bool": bool, "float": (int, float), "object": (str, int, dict)}


def mismatches(manifest):
    """What in a manifest, as YAML gives it, is not as the API has it: a list of words."""
    version, kind = manifest["apiVersion"], manifest["kind"]
    name = EARLIER_NAMES.get((version, kind))
    if name is None:
        number = version.rsplit("/", 1)[-1]
        name = number[0].upper() + number[1:] + kind
    if not hasattr(kubernetes.client, name):
        return [f"{kind}: {version} has none"]
    found = []
    _read(manifest, name, kind, found)
    return found


def _read(value, kind, where, found):
    """The value as the API's class of that name, or None; appends to `found`."""
    inner = re.fullmatch(r"(list\[|dict\(str, )(.+)[\])]", kind)
    if inner:
        wanted = list if inner[1] == "list[" else dict
        if not isinstance(value, wanted):
            found.append(f"{where}: {value!r} is no {wanted.__name__}")
        elif wanted is list:
            return [_read(item, inner[2], f"{where}[{i}]", found) for i, item in enumerate(value)]
        else:
            return {key: _read(item, inner[2], f"{where}.{key}", found) for key, item in value.items()}
        return None
    if kind in PRIMITIVES:
        # A bool is an int to Python, and to nobody else.
        if not isinstance(value, PRIMITIVES[kind]) or (isinstance(value, bool) and kind != "bool"):
            found.append(f"{where}: {value!r} is no {kind}")
        return value
    model = getattr(kubernetes.client, kind)
    if not isinstance(value, dict):
        found.append(f"{where}: {value!r} is no {kind}")
        return None
    attributes = {field: attribute for attribute, field in model.attribute_map.items()}
    known = {}
    before = len(found)
    for field, item in value.items():
        if field not in attributes:
            found.append(f"{where}: {kind} has no field {field}")
            continue
        attribute = attributes[field]
        known[attribute] = _read(item, model.openapi_types[attribute], f"{where}.{field}", found)
    if len(found) > before:
        return None  # what is missing below would be told once more
    try:
        return model(**known)
    except ValueError as error:
        found.append(f"{where}: {error}")
        return None
