"""``nsfc env``: what this software runs on, to paste into a report."""

from typing import Any

import rich_click as click

from cli.console import Console
from cli.options import json_option
from cli.provenance import versions
from warp_caustics.device import start_device


@click.command()
@json_option
def env(as_json: bool) -> None:
    """Print versions, devices, memory and the place of compiled kernels."""
    console = Console(as_json)
    found = environment()
    width = max(map(len, found["versions"]))
    for name, version in found["versions"].items():
        console.line(f"{name:<{width}}  {version}")
    console.line(f"{'system':<{width}}  {found['system']}")
    console.line(f"{'cpu':<{width}}  {found['cpu']['model']}, {found['cpu']['cores']} cores")
    console.line(f"{'memory':<{width}}  {found['memory_bytes'] / 2**30:.1f} GiB")
    for device in found["cuda"]:
        memory = device["memory_bytes"] / 2**30
        console.line(f"{device['device']:<{width}}  {device['name']}, {memory:.1f} GiB, sm_{device['capability']}")
    if not found["cuda"]:
        console.line(f"{'cuda':<{width}}  no device")
    console.line(f"{'kernels':<{width}}  {found['kernel_cache']}")
    console.record(found)


def environment() -> dict[str, Any]:
    """Versions, system, processor, memory [bytes], CUDA devices and kernel cache."""
    import os
    import platform

    import torch
    import warp

    start_device("auto")
    cuda = []
    for index in range(torch.cuda.device_count() if torch.cuda.is_available() else 0):
        properties = torch.cuda.get_device_properties(index)
        cuda.append(
            {
                "device": f"cuda:{index}",
                "name": properties.name,
                "memory_bytes": properties.total_memory,
                "capability": f"{properties.major}{properties.minor}",
            }
        )
    return {
        "versions": versions(),
        "system": platform.platform(),
        "cpu": {"model": _cpu_model(), "cores": len(os.sched_getaffinity(0))},
        "memory_bytes": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"),
        "cuda": cuda,
        "kernel_cache": str(warp.config.kernel_cache_dir),
    }


def _cpu_model() -> str:
    import platform

    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as file:
            names = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return names[0] if names else platform.machine()
