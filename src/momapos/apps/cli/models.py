"""momapos models: list and download detector weights."""

from __future__ import annotations

from typing import Annotated

from tyro.conf import Positional, arg

from momapos.core import InputError, say, unknown_name

from .options import Text, optional


def models_get(
    name: Annotated[Positional[str], arg(metavar="NAME")],
    /,
    *,
    url: Annotated[Text, optional("URL")] = None,
    sha256: Annotated[Text, optional("HASH")] = None,
) -> int:
    """Download detector weights, check their hash and cache them, for `momapos scan --detector`.

    The message without a network says where to put the file.

    Args:
        name: A name from `momapos models list`, or a new name for --url and --sha256.
        url: An https address of weights that are not listed.
        sha256: Hash of those weights, 64 hexadecimal digits.
    """
    from momapos.core import default_cache_dir
    from momapos.perception.detection import MODELS, ModelFile, fetch

    if (url is None) != (sha256 is None):
        raise InputError("--url and --sha256 need each other")
    if url is not None and sha256 is not None:
        if name in MODELS:
            raise InputError(f"{name} is already listed; choose another name")
        model = ModelFile(name, url, sha256.lower())
    elif name in MODELS:
        model = MODELS[name]
    else:
        raise unknown_name("model", name, MODELS, "momapos models list")
    say(fetch(model, default_cache_dir()))
    return 0


def models_list() -> int:
    """List the weights that can be downloaded by name, and the cached ones."""
    from momapos.core import default_cache_dir
    from momapos.perception.detection import MODELS, cached_models, cached_path

    cache = default_cache_dir()
    kept = cached_models(cache)
    for name in dict.fromkeys([*MODELS, *kept]):
        about = MODELS[name].about if name in MODELS else "downloaded from a given address"
        state = str(cached_path(name, cache)) if name in kept else f"momapos models get {name}"
        say(f"  {name:<16} {about}\n  {'':<16} {state}")
    return 0
