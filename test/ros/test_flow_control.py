"""A replay is never more than a second of flight ahead of the slowest of its listeners."""

from types import SimpleNamespace

from dlsc_qbs_ros.core.types import View
from dlsc_qbs_ros.nodes import flow_control
from dlsc_qbs_ros.nodes.flow_control import FlowControl
from dlsc_qbs_ros.ros.conversions import view_to_msg
from dlsc_qbs_ros.ros.serialization import serialize
import numpy as np
import pytest

START_NS = 1_600_000_000_000_000_000
SECOND_NS = 1_000_000_000


class Graph:
    """Results that come one by one, each time the node is spun."""

    def __init__(self, published=('/code', '/pose'), results=()):
        self.watchers, self.warnings = {}, []
        self._published, self._results = published, list(results)

    def flow(self, played=()):
        node = SimpleNamespace(
            resolve_topic_name=lambda topic: f'/{topic}',
            count_publishers=lambda name: int(name in self._published),
            create_subscription=lambda msg_type, topic, callback, *_, **__:
                self.watchers.update({f'/{topic}': callback}),
            get_logger=lambda: SimpleNamespace(warning=self.warnings.append))
        return FlowControl(node, played, self.spin)

    def spin(self, _):
        if self._results:
            name, stamp_ns = self._results.pop(0)
            self.watchers[name](serialize(view_to_msg(
                View(START_NS + stamp_ns, np.zeros((1, 1), np.uint8)))))
        return True

    def left(self):
        return len(self._results)


@pytest.fixture(autouse=True)
def short_patience(monkeypatch):
    monkeypatch.setattr(flow_control, 'PATIENCE_S', 0.01)


def test_within_a_second_nobody_is_waited_for():
    graph = Graph(results=[('/code', 1)])
    flow = graph.flow()
    flow.stay_close(START_NS)
    flow.stay_close(START_NS + SECOND_NS)
    assert graph.left() == 1


def test_beyond_a_second_the_slowest_is_waited_for():
    graph = Graph(results=[
        ('/code', 2), ('/pose', 0), ('/pose', 1), ('/code', 9)])
    flow = graph.flow()
    flow.stay_close(START_NS)
    flow.stay_close(START_NS + SECOND_NS + 1)
    assert graph.left() == 1
    assert not graph.warnings


def test_who_publishes_nothing_is_not_waited_for():
    graph = Graph(published=(), results=[('/code', 1)])
    flow = graph.flow()
    flow.stay_close(START_NS)
    flow.stay_close(START_NS + 9 * SECOND_NS)
    assert graph.left() == 1


def test_what_is_played_is_not_watched():
    graph = Graph()
    graph.flow(played={'/code'})
    assert set(graph.watchers) == {'/pose'}


def test_who_stays_silent_is_left_behind_until_it_speaks_again():
    graph = Graph(published=('/code',))
    flow = graph.flow()
    flow.stay_close(START_NS)
    flow.stay_close(START_NS + 2 * SECOND_NS)
    assert graph.warnings == ['no new /code for 0.01 s: going on without it']
    flow.stay_close(START_NS + 3 * SECOND_NS)
    assert len(graph.warnings) == 1
    graph._results = [('/code', 3 * SECOND_NS), ('/code', 4 * SECOND_NS), ('/code', 9)]
    graph.spin(0)
    flow.stay_close(START_NS + 5 * SECOND_NS)
    assert graph.left() == 1
