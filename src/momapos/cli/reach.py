"""momapos reach: reachability maps."""

from __future__ import annotations

from tyro.conf import Positional

from momapos.cli.options import OptionalPath
from momapos.robots.names import find_named_robot


def reach_build(
    robot: Positional[str],
    /,
    *,
    cache: OptionalPath = None,
    out: OptionalPath = None,
    json: bool = False,
) -> int:
    """Build a robot's reachability map, or find it ready.

    Args:
        robot: A library robot or a robot file.
        cache: Folder of the cache.
        out: Build it afresh into this file; NAME.reach beside NAME.toml is found by itself.
        json: Print one JSON object.
    """
    find_named_robot(robot)  # a mistyped name is told before anything heavy is imported
    import json as encoder
    import time

    from momapos.cache import Cache, default_cache_dir, write_atomic
    from momapos.cli.console import progress
    from momapos.files import check_outputs
    from momapos.reachability.construct import build_map, default_config
    from momapos.reachability.store import encode, load_reach_map, map_key
    from momapos.robots.robot import load_robot

    check_outputs([out], [cache])
    kept = cache or default_cache_dir()
    machine, where = load_robot(robot, cache=Cache(kept)), out or kept
    began = time.perf_counter()
    with progress(f"reachability map of {machine.name}") as report:
        if out is None:
            load_reach_map(machine, where, report)
        else:
            config = default_config(machine)
            key = map_key(machine, config)
            write_atomic(out, encode(build_map(machine, config, progress=report, key=key)))
    seconds = time.perf_counter() - began
    if json:
        print(encoder.dumps({"robot": machine.name, "path": str(where), "seconds": seconds}))
    else:
        print(f"reachability map of {machine.name}: ready after {seconds:.1f} s in {where}")
    return 0


def reach_eval(
    robot: Positional[str], /, *, count: int = 20_000, seed: int = 0, cache: OptionalPath = None,
    json: bool = False,
) -> int:  # fmt: skip
    """Hold a robot's reachability map against exact inverse kinematics.

    Args:
        robot: A library robot or a robot file.
        count: Number of random tool poses.
        seed: Seed of the poses.
        cache: Folder of the cache.
        json: Print one JSON object.
    """
    find_named_robot(robot)
    import json as encoder
    from dataclasses import asdict

    import numpy as np

    from momapos.cache import Cache, default_cache_dir
    from momapos.cli.console import progress
    from momapos.cli.options import check_seed
    from momapos.errors import InputError
    from momapos.files import check_outputs
    from momapos.reachability.evaluation import evaluate
    from momapos.reachability.store import load_reach_map
    from momapos.robots.robot import load_robot

    if not 0 < count <= 10_000_000:
        raise InputError("--count must be between 1 and 10000000")
    check_seed(seed)
    check_outputs(folders=[cache])
    kept = cache or default_cache_dir()
    machine = load_robot(robot, cache=Cache(kept))
    with progress(f"reachability map of {machine.name}") as report:
        reach = load_reach_map(machine, kept, report)
    result = asdict(evaluate(reach, machine, np.random.default_rng(seed), count))
    if json:
        print(encoder.dumps({"robot": machine.name, **result}))
    else:
        width = max(len(name) for name in result)
        for name, value in result.items():
            print(f"{name:<{width}}  {value:.4g}")
    return 0
