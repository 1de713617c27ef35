"""What things are called: what was given or seen before what their size allows."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

from momapos.core import InputError, unknown_name
from momapos.model.records import UNKNOWN, Detection

from .votes import Verdict, VoteConfig

_LABEL = re.compile(r"[a-z][a-z ]{0,39}")


def relabeled(
    things: Sequence[Detection],
    verdicts: Sequence[Verdict],
    told: frozenset[str],
    config: VoteConfig | None = None,
) -> list[Detection]:
    """Name things by what was seen of them.

    Where the images agree, theirs is the label. A guess by size is taken back where the detector
    knows such things and enough images of this one were looked at without finding one; what the
    size allows besides is left, or nothing.

    Args:
        things: As the segmenter and their sizes name them.
        verdicts: What the images say of each.
        told: All labels that the detector can give.
        config: Constants.
    """
    config = config or VoteConfig()
    return [
        _relabeled(item, verdict, told, config)
        for item, verdict in zip(things, verdicts, strict=True)
    ]


def _relabeled(
    item: Detection, verdict: Verdict, told: frozenset[str], config: VoteConfig
) -> Detection:
    if verdict.label:
        return replace(
            item, label=verdict.label, score=verdict.confidence, label_from="detector", guesses=()
        )
    if item.label_from != "size":
        return item
    doubt = max(0.0, 1.0 - verdict.seen / config.misses)
    label, least = UNKNOWN
    left = [(name, score * (doubt if name in told else 1.0)) for name, score in item.guesses]
    left = [(name, score) for name, score in left if score >= least]
    best, score = max(left, key=lambda pair: pair[1], default=(label, least))
    return replace(item, label=best, score=min(score, item.score), guesses=tuple(left))


def with_given_labels(things: Sequence[Detection], labels: Mapping[str, str]) -> list[Detection]:
    """Name things as the user says.

    Args:
        things: With names.
        labels: The labels by name.

    Raises:
        UnknownNameError: Nothing has one of the names.
        InputError: A label cannot be one.
    """
    names = [item.name for item in things]
    for name, label in labels.items():
        if name not in names:
            raise unknown_name("object", name, names, "the scan")
        if not _LABEL.fullmatch(label):
            raise InputError(
                f"label {label!r:.60} of {name!r}: must be up to 40 small letters and spaces, "
                "as in 'wall cabinet'"
            )
    return [
        replace(item, label=labels[item.name], score=1.0, label_from="given", guesses=())
        if item.name in labels
        else item
        for item in things
    ]


def parse_labels(texts: Sequence[str]) -> dict[str, str]:
    """Read OBJECT=LABEL texts.

    Raises:
        InputError: One is written otherwise, or an object is named twice.
    """
    pairs = []
    for text in texts:
        name, equals, label = text.partition("=")
        if not (equals and name and label):
            raise InputError(f"--label {text!r:.80}: must be OBJECT=LABEL, as in object_3=fridge")
        pairs.append((name, label))
    for (one, _), (other, _) in pairwise(sorted(pairs)):
        if one == other:
            raise InputError(f"--label names {one!r} twice")
    return dict(pairs)
