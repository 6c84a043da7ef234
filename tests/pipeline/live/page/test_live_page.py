"""What the page is told, and to whom."""

from __future__ import annotations

import http.client
import json

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.live.page.live_server import LivePage
from pipeline.live.page.live_state import MOST_PARTS, MOST_PLACES, LiveState
from pipeline.live.review_worker import MissedPlace, Review
from pipeline.live.surface_part import SurfacePart


def part(number, map_number=0, version=1):
    rng = np.random.default_rng(number)
    vertices, faces = rng.normal(size=(7, 3)).astype(np.float32), rng.integers(0, 7, (5, 3)).astype(np.uint32)
    colours = rng.integers(0, 256, (7, 3)).astype(np.uint8)
    return SurfacePart(number, version, map_number, (number, number), vertices, faces, colours, 0.01)


@pytest.fixture
def page():
    served = LivePage(LiveState("film.mp4"))
    served.show(open_browser=False)
    yield served
    served.end()


def ask(page, path, method="GET", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", page.server_address[1], timeout=30)
    connection.request(method, path, headers=headers)
    answer = connection.getresponse()
    return answer.status, answer.read()


def test_a_part_arrives_as_it_is(page):
    sent = part(3)
    page.state.add_parts((sent,))
    status, body = ask(page, "/surface/3")
    counts = np.frombuffer(body, "<u4", 2)
    vertices, faces = np.frombuffer(body, "<f4", 21, 8), np.frombuffer(body, "<u4", 15, 8 + 84)
    assert (status, counts.tolist()) == (200, [7, 5])
    np.testing.assert_array_equal(vertices.reshape(7, 3), sent.vertices)
    np.testing.assert_array_equal(faces.reshape(5, 3), sent.faces)
    np.testing.assert_array_equal(np.frombuffer(body, np.uint8, offset=8 + 84 + 60).reshape(7, 3), sent.colours)


def test_only_the_current_map_is_drawn_and_memory_is_bounded():
    state = LiveState()
    for frame in range(10 * MOST_PLACES):
        world_from_camera = np.eye(4)
        world_from_camera[2, 3] = frame
        state.add_pose(frame, world_from_camera, 1)
    state.add_parts(tuple(part(number, number % 2) for number in range(MOST_PARTS + 10)))
    told = state.to_dict()
    assert len(state.parts) == MOST_PARTS
    assert [number % 2 for number, _, _ in told["parts"]] == [1] * (MOST_PARTS // 2)
    assert told["earlier"] == MOST_PARTS // 2 + 10
    assert len(told["path"]) <= 2 * MOST_PLACES
    assert told["path"][0][2] == 0


def test_a_review_is_told_of_its_own_map_alone():
    state = LiveState()
    state.add_pose(0, np.eye(4), 0)
    state.add_parts((part(0), part(1)))
    move = np.eye(4)
    move[0, 3] = 2.0
    place = MissedPlace(3.0, 0.5, 12, (0.0, 1.0, 2.0), 0.4)
    state.add_review(Review(0, 20, corrections={0: move, 1: np.eye(4)}, covered=0.875, missed=(place,)))
    told = json.loads(json.dumps(state.to_dict(), allow_nan=False))
    assert told["parts"][0][2][3] == 2.0
    assert told["coverage"]["covered"] == 87.5
    assert told["coverage"]["missed"][0]["seconds"] == 0.4
    state.add_pose(1, np.eye(4), 1)
    assert state.to_dict()["coverage"] is None


@pytest.mark.parametrize("path", ["/surface/9", "/surface/x", "/frame.jpg", "/run.yaml", "/../secret", "/assets/none"])
def test_nothing_else_is_given(page, path):
    assert ask(page, path)[0] == 404


def test_a_foreign_page_reads_nothing_and_stops_nothing(page):
    assert ask(page, "/state", Host="evil.example")[0] == 403
    assert ask(page, "/stop", "POST")[0] == 403
    assert ask(page, "/stop", "POST", **{"X-Haustra": "stop", "Host": "evil.example"})[0] == 403
    assert not page.state.stop_asked.is_set()
    assert ask(page, "/stop", "POST", **{"X-Haustra": "stop"})[0] == 204
    assert page.state.stop_asked.is_set()


def test_the_page_listens_to_this_machine_alone(page):
    assert page.server_address[0] == "127.0.0.1"


def test_a_port_that_is_taken_is_one_sentence(page):
    with pytest.raises(HaustraError, match="leave --port out"):
        LivePage(LiveState(), page.server_address[1])
