"""Relabel objects by the user's labels and by the images, instead of by size."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

from momapos.core import InputError, unknown_name
from momapos.model.records import UNKNOWN, Detection

from .votes import MAX_MISSES, Verdict

_LABEL = re.compile(r"[a-z][a-z ]{0,39}")


def relabeled(
    objects: Sequence[Detection],
    verdicts: Sequence[Verdict],
    known: frozenset[str],
) -> list[Detection]:
    """Relabel objects by the votes of the images.

    If the images agree on a label, it is used. A label by size loses confidence with each image
    that shows the object without a detection, if the detector knows that label; the best remaining
    guess by size is used.

    Args:
        objects: Objects with labels by segmenter and size.
        verdicts: Result of the votes for each.
        known: All labels that the detector knows.
    """
    return [
        _relabeled(item, verdict, known) for item, verdict in zip(objects, verdicts, strict=True)
    ]


def _relabeled(item: Detection, verdict: Verdict, known: frozenset[str]) -> Detection:
    if verdict.label:
        return replace(
            item, label=verdict.label, score=verdict.confidence, label_from="detector", guesses=()
        )
    if item.label_from != "size":
        return item
    doubt = max(0.0, 1.0 - verdict.seen / MAX_MISSES)
    label, least = UNKNOWN
    left = [(name, score * (doubt if name in known else 1.0)) for name, score in item.guesses]
    left = [(name, score) for name, score in left if score >= least]
    best, score = max(left, key=lambda pair: pair[1], default=(label, least))
    return replace(item, label=best, score=min(score, item.score), guesses=tuple(left))


def with_given_labels(objects: Sequence[Detection], labels: Mapping[str, str]) -> list[Detection]:
    """Relabel objects as the user says.

    Args:
        objects: Named objects.
        labels: The labels by name.

    Raises:
        UnknownNameError: No object has one of the names.
        InputError: A label is not valid.
    """
    names = [item.name for item in objects]
    for name, label in labels.items():
        if name not in names:
            raise unknown_name("object", name, names, "the scan")
        if not _LABEL.fullmatch(label):
            raise InputError(
                f"label {label!r:.60} of {name!r} must be up to 40 lowercase letters and spaces, "
                "as in 'wall cabinet'"
            )
    return [
        replace(item, label=labels[item.name], score=1.0, label_from="given", guesses=())
        if item.name in labels
        else item
        for item in objects
    ]


def parse_labels(texts: Sequence[str]) -> dict[str, str]:
    """Read OBJECT=LABEL texts.

    Raises:
        InputError: A text has another form, or an object is named twice.
    """
    pairs = []
    for text in texts:
        name, equals, label = text.partition("=")
        if not (equals and name and label):
            raise InputError(f"label {text!r:.80} must be OBJECT=LABEL, as in object_3=fridge")
        pairs.append((name, label))
    for (one, _), (other, _) in pairwise(sorted(pairs)):
        if one == other:
            raise InputError(f"label names {one!r} twice")
    return dict(pairs)
