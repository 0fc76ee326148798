"""What makes two images the same on any engine and store?"""

from __future__ import annotations

from typing import Any

IDENTITY = (
    "{{.Os}}/{{.Architecture}}{{println}}{{range .RootFS.Layers}}layer {{println .}}{{end}}"
    "{{with .Config}}{{range .Env}}env {{println .}}{{end}}{{range .Entrypoint}}entrypoint {{println .}}{{end}}"
    "{{range .Cmd}}cmd {{println .}}{{end}}user {{println .User}}directory {{println .WorkingDir}}"
    "{{range $path, $_ := .Volumes}}volume {{println $path}}{{end}}{{with .StopSignal}}stop {{println .}}{{end}}"
    "{{with .Healthcheck}}{{range .Test}}check {{println .}}{{end}}"
    '{{printf "checked %d %d %d %d" .Interval .Timeout .StartPeriod .Retries | println}}{{end}}{{end}}'
)
"""A ``docker image inspect --format`` template whose lines are equal exactly for equal images, on any engine and store.

An image's ID differs between Docker's classic and containerd stores (moby #48401); these lines do not.
"""


def identity(attributes: dict[str, Any]) -> str:
    """The lines that `IDENTITY` prints, computed from an image's inspection on this computer."""
    config = attributes.get("Config") or {}
    lines = [f"{attributes['Os']}/{attributes['Architecture']}"]
    lines += [f"layer {layer}" for layer in attributes["RootFS"].get("Layers") or []]
    for word, key in (("env", "Env"), ("entrypoint", "Entrypoint"), ("cmd", "Cmd")):
        lines += [f"{word} {value}" for value in config.get(key) or []]
    lines += [f"user {config.get('User') or ''}", f"directory {config.get('WorkingDir') or ''}"]
    lines += [f"volume {path}" for path in sorted(config.get("Volumes") or {})]
    lines += [f"stop {signal}" for signal in [config.get("StopSignal")] if signal]
    if check := config.get("Healthcheck"):
        times = (check.get(key, 0) for key in ("Interval", "Timeout", "StartPeriod", "Retries"))
        lines += [
            *(f"check {word}" for word in check.get("Test") or []),
            "checked {} {} {} {}".format(*times),
        ]
    return "\n".join(lines).strip()
