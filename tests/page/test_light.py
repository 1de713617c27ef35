"""A large room is lit plainly until a person says otherwise; nothing that is set is sent again."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from momapos.cache import user_cache
from momapos.page.light import NAME
from momapos.page.page import Page
from momapos.page.serve import served
from momapos.scene.files import load_scene, save_scene
from momapos.scene.scene import Scene, SceneObject

LONG = 60.0


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A page that nobody looks at; its scenes are a kitchen and a hall."""
    folder = tmp_path_factory.mktemp("page")
    crates = (
        SceneObject.box(f"crate_{k}", (0.5,) * 3, (k % 20, 3 + k // 20, 0.25)) for k in range(300)
    )
    hall = folder / "hall.json"
    fridge = SceneObject.box("fridge", (0.6, 0.6, 1.8), (0.0, 0.0, 0.9))
    save_scene(Scene("hall", (fridge, *crates)), hall)
    with served(
        host="127.0.0.1", port=0, scenes=("kitchen_small", str(hall)), robots=("segway_ur5e",),
        scene="kitchen_small", robot="segway_ur5e", cache=user_cache(), folder=folder,
    ) as (page, _):  # fmt: skip
        assert page.work.wait(LONG)
        yield page


@pytest.fixture
def sent(page: Page, monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What pages are told of the light."""
    told: list[Any] = []
    interface = page.server.scene._websock_interface
    say = interface.queue_message

    def tell(message: Any) -> None:
        if type(message).__name__ in ("EnableLightsMessage", "EnvironmentMapMessage"):
            told.append(message)
        say(message)

    monkeypatch.setattr(interface, "queue_message", tell)
    return told


def choose(page: Page, scene: str) -> None:
    page.panel.scene.value = scene
    page.change()
    assert page.work.wait(LONG)


def test_a_large_room_is_lit_plainly_until_a_person_says_otherwise(
    page: Page, sent: list[Any]
) -> None:
    kitchen, hall = page.panel.scene.options
    assert not page.panel.plain.value
    choose(page, hall)
    assert page.panel.plain.value
    lights, sky = sent
    assert (lights.cast_shadow, sky.hdri_data) == (False, None)
    assert page.server.scene.get_handle_by_name(NAME) is not None
    page.panel.plain.value = False
    page.light.changed()
    lights, sky = sent[2:]
    assert lights.cast_shadow
    assert len(sky.hdri_data) > 0
    assert page.server.scene.get_handle_by_name(NAME) is None
    choose(page, kitchen)
    choose(page, hall)
    assert page.panel.plain.value
    choose(page, kitchen)
    assert not page.panel.plain.value


def test_light_that_is_set_is_not_sent_again(page: Page, sent: list[Any]) -> None:
    page.light.changed()
    page.light.of_room(load_scene("kitchen_small"))
    assert sent == []
    page.panel.plain.value = True
    page.light.changed()
    page.light.changed()
    assert len(sent) == 2
    page.panel.plain.value = False
    page.light.changed()
    assert len(sent) == 4
