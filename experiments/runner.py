"""One run: its folder, what is written around the recipe, and when a run is skipped, resumed or begun anew."""

import datetime
import hashlib
import importlib.metadata
import json
import platform
import shutil
import subprocess
from pathlib import Path
from typing import Any

import jax
import tomli_w

from experiments import config as configs, recipes, stages
from experiments.progress import Voice
from experiments.record import Record
from hshjax.cli._devices import several_devices

ROOT = Path(__file__).parents[1]
PACKAGES = ("hshjax", "jax", "jaxlib", "equinox", "lineax", "optimistix", "numpy")


def start(devices: int) -> None:
    """Before anything is computed: JAX will have so many devices.

    **Raises:** ValueError where it has not.
    """
    several_devices(devices)


def folder_of(config: configs.RecipeConfig, runs: Path) -> Path:
    """runs/<name>-<hash of the resolved config>."""
    return runs / f"{config.name}-{configs.digest(config)}"


def run(
    config: configs.RecipeConfig, runs: Path, voice: Voice, *, force: bool = False, keep_stages: bool = False
) -> Path:
    """Runs the recipe of a config, unless that is done already; the path of the report.

    The stages of an interrupted run are used again if code, versions and device are the same, or under `keep_stages`.
    With `start`, this is the one place that configures jax.

    **Raises:** ValueError where JAX has fewer devices than the config asks for.
    """
    jax.config.update("jax_enable_x64", config.dtype == "float64")
    folder = folder_of(config, runs)
    report = folder / "report.html"
    if force and (folder / "manifest.json").exists():
        shutil.rmtree(folder)
    before = _read_manifest(folder)
    code = _code()
    if (folder / "metrics.json").exists():
        voice.say(f"{config.name}: done before; --force does it again")
        if before is not None and before["code"] != code:
            voice.say(f"{config.name}: note that code, versions or device have changed since")
        return report

    if before is not None and (folder / "stages").exists():
        if before["code"] == code or keep_stages:
            voice.say(f"{config.name}: resumed")
        else:
            voice.say(f"{config.name}: begun anew, for code, versions or device have changed (--keep-stages resumes)")
            shutil.rmtree(folder)
            before = None
    folder.mkdir(parents=True, exist_ok=True)
    for partial in folder.rglob(".*.partial"):  # of a process that was killed
        partial.unlink()
    manifest = _manifest(config, code, before)
    config_toml = tomli_w.dumps(configs.as_table(config))
    stages.write_text(folder / "config.toml", config_toml)
    stages.write_text(folder / "manifest.json", json.dumps(manifest, indent=2) + "\n")

    record = Record(folder, config.seed, voice, several_devices(config.devices))
    recipes.load(config.recipe).run(config, record)
    return record.finish(manifest, config_toml, recipes.summary(config.recipe))


def _read_manifest(folder: Path) -> dict[str, Any] | None:
    path = folder / "manifest.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else None


def _manifest(config: configs.RecipeConfig, code: dict[str, str], before: dict[str, Any] | None) -> dict[str, Any]:
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {
        "name": config.name,
        "recipe": config.recipe,
        "seed": config.seed,
        "dtype": config.dtype,
        "devices": config.devices,
        "started": now if before is None else before["started"],
        "resumed": [] if before is None else [*before["resumed"], now],
        "versions": {"python": platform.python_version()}
        | {name: importlib.metadata.version(name) for name in PACKAGES},
        "device": _device(),
        "git": _git(),
        "code": code,
    }


def _device() -> str:
    device = jax.devices()[0]
    return device.platform if device.device_kind == device.platform else f"{device.platform}, {device.device_kind}"


def _code() -> dict[str, str]:
    """What a stage's result depends on besides the config: our sources, what they stand on, and the device."""
    sources = hashlib.sha256()
    for package in ("hshjax", "experiments"):
        for path in sorted((ROOT / package).rglob("*.py")):
            sources.update(path.relative_to(ROOT).as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    versions = " ".join(f"{name} {importlib.metadata.version(name)}" for name in PACKAGES)
    return {"sources": sources.hexdigest()[:16], "versions": versions, "device": _device()}


def _git() -> dict[str, Any]:
    """Revision of the repository and whether it has uncommitted changes; None for both outside a repository."""

    def git(*arguments: str) -> str | None:
        try:
            done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True)
        except (OSError, subprocess.CalledProcessError):  # no git, or no repository
            return None
        return done.stdout.strip()

    status = git("status", "--porcelain")
    return {"revision": git("rev-parse", "HEAD"), "dirty": None if status is None else bool(status)}
