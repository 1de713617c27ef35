"""momapos models: weights of detectors, fetched once."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import Positional, arg

from momapos.core import InputError, unknown_name

from .options import OptionalText


def models_get(
    name: Annotated[Positional[str], arg(metavar="NAME")],
    /,
    *,
    url: OptionalText = None,
    sha256: OptionalText = None,
) -> int:
    """Download the weights of a detector, check their hash, and keep them.

    They are used as `momapos scan --detector NAME`. Without a network, give the file there.

    Args:
        name: One of `momapos models list`, or a new name for --url and --sha256.
        url: An https address, of weights that are not listed.
        sha256: Hash of those weights, 64 hexadecimal digits.
    """
    from momapos.core import default_cache_dir
    from momapos.perception.detection import MODELS, ModelFile, fetch

    if (url is None) != (sha256 is None):
        raise InputError("--url and --sha256 belong together: a file is known by its hash")
    if url is not None and sha256 is not None:
        if name in MODELS:
            raise InputError(f"{name} is listed with an address of its own; give another name")
        model = ModelFile(name, url, sha256.lower())
    elif name in MODELS:
        model = MODELS[name]
    else:
        raise unknown_name("model", name, MODELS, "momapos models list")
    print(fetch(model, default_cache_dir()))
    return 0


def models_list() -> int:
    """Weights that can be fetched by name, and those that were."""
    from momapos.core import default_cache_dir
    from momapos.perception.detection import MODELS, kept_at, kept_models

    cache = default_cache_dir()
    kept = kept_models(cache)
    for name in dict.fromkeys([*MODELS, *kept]):
        about = MODELS[name].about if name in MODELS else "fetched from a given address"
        state = str(kept_at(name, cache)) if name in kept else f"momapos models get {name}"
        print(f"  {name:<16} {about}\n  {'':<16} {state}")
    return 0
