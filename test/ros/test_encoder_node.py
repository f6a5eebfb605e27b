"""The encoder node, as a process: codes carry the stamps of images, and no image kills it."""

from array import array

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import Frame
from dlsc_qbs_ros.pipeline.encoder import Encoder
from dlsc_qbs_ros.ros.conversions import code_from_msg, dictionary_from_msg, view_from_msg
from dlsc_qbs_ros.ros.image_conversions import image_to_msg
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image

RELIABLE = ['-p', 'qos_overrides./image.subscription.reliability:=reliable',
            '-p', 'qos_overrides./image.subscription.depth:=1000']
PERIOD_NS = 100_000_000
START_NS = 1_600_000_000_000_000_000


def frames(n, seed=0):
    rng = np.random.default_rng(seed)
    return [Frame(START_NS + k * PERIOD_NS, rng.integers(0, 256, (65, 86), dtype=np.uint8))
            for k in range(n)]


def to_msg(frame):
    return image_to_msg(frame.stamp_ns, frame.grey, 'mono8', 'camera')


class Graph:
    """An encoder and what it publishes."""

    def __init__(self, start, observer, *ros_args, image_type=Image):
        self.observer = observer
        self.codes = observer.collect(Image, 'code')
        self.views = observer.collect(Image, 'view')
        self.dictionaries = observer.collect(
            Image, 'dictionary', durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.reports = observer.collect(DiagnosticArray, '/diagnostics')
        self.images = observer.advertise(image_type, 'image')
        self.process = start('nodes.encoder_node', '--ros-args', *RELIABLE, *ros_args)
        observer.spin_until(lambda: self.reports and all(
            observer.node.count_publishers(topic) for topic in ('code', 'view', 'dictionary')))
        observer.spin_until(self.images.get_subscription_count)

    def send(self, messages):
        for message in messages:
            self.images.publish(message)

    def codes_of(self, n):
        self.observer.spin_until(lambda: len(self.codes) >= n and len(self.views) >= n)
        return [code_from_msg(message) for message in self.codes]

    def report(self, condition):
        """Return the first report, as (level, values), for which the condition holds."""
        found = []

        def look():
            for report in self.reports:
                values = {value.key: value.value for value in report.status[0].values}
                if condition(values):
                    found.append((report.status[0].level, values))
            return found
        self.observer.spin_until(look)
        return found[0]


@pytest.fixture
def graph(start, observer):
    return Graph(start, observer)


def test_codes_views_and_dictionaries_are_those_of_the_pipeline(graph):
    sent = frames(30)
    graph.send(map(to_msg, sent))
    codes = graph.codes_of(len(sent))
    views = [view_from_msg(message) for message in graph.views]
    dictionaries = [dictionary_from_msg(message) for message in graph.dictionaries]

    encoder = Encoder(Config())
    expected = [encoder.process(frame) for frame in sent]
    assert [code.stamp_ns for code in codes] == [frame.stamp_ns for frame in sent]
    assert [code.dictionary_ns for code in codes] == [e.code.dictionary_ns for e in expected]
    for code, view, e in zip(codes, views, expected):
        np.testing.assert_array_equal(code.values, e.code.values)
        np.testing.assert_array_equal(view.pixels, e.view.pixels)
        assert view.stamp_ns == e.view.stamp_ns
    epochs = [e.dictionary for e in expected if e.dictionary is not None]
    assert [d.stamp_ns for d in dictionaries] == [d.stamp_ns for d in epochs]
    for dictionary, epoch in zip(dictionaries, epochs):
        np.testing.assert_array_equal(dictionary.atoms, epoch.atoms)


def truncated(message):
    message.data = message.data[:100]
    return message


def unknown(message):
    message.encoding = 'jpeg2000'
    return message


def sizeless(message):
    message.width = 0
    return message


@pytest.mark.parametrize('spoil', [truncated, unknown, sizeless])
def test_a_malformed_image_is_refused_counted_and_survived(graph, spoil):
    sent = [to_msg(frame) for frame in frames(3)]
    graph.send([sent[0], spoil(sent[1]), sent[2]])
    codes = graph.codes_of(2)
    assert [code.stamp_ns for code in codes] == [START_NS, START_NS + 2 * PERIOD_NS]
    level, values = graph.report(lambda values: values['received'] == '3')
    assert level == DiagnosticStatus.WARN
    assert (values['encoded'], values['refused_malformed']) == ('2', '1')
    assert 'image refused' in graph.process.text()
    assert graph.process.stop() == 0


def test_stamps_that_do_not_rise_are_refused_and_counted(graph):
    a, b, c = map(to_msg, frames(3))
    graph.send([b, b, a, c])
    assert [code.stamp_ns - START_NS for code in graph.codes_of(2)] == [PERIOD_NS, 2 * PERIOD_NS]
    _, values = graph.report(lambda values: values['received'] == '4')
    assert (values['encoded'], values['refused_out_of_order']) == ('2', '2')


def test_a_long_fall_of_the_stamps_is_a_flight_started_again(graph):
    sent = frames(15)
    graph.send([to_msg(sent[14]), to_msg(sent[0]), to_msg(sent[1])])
    assert [code.stamp_ns for code in graph.codes_of(3)] == [
        frame.stamp_ns for frame in (sent[14], sent[0], sent[1])]
    _, values = graph.report(lambda values: values['received'] == '3')
    assert values['refused_out_of_order'] == '0'


def test_the_report_tells_how_it_goes(graph):
    graph.send(map(to_msg, frames(10)))
    graph.codes_of(10)
    _, values = graph.report(lambda values: values['encoded'] == '10')
    assert values['lost'] == '0'
    assert float(values['rate_hz']) > 0
    assert float(values['latency_ms']) > 0
    assert 0 <= float(values['gate_open_share']) <= 1
    assert {'surprise', 'epoch', 'reprojection_error', 'learned'} <= set(values)


def test_compressed_images_are_encoded_and_bad_ones_refused(start, observer):
    import cv2
    graph = Graph(start, observer, '-p', 'image.compressed:=true', image_type=CompressedImage)
    sent = frames(2)
    messages = []
    for frame in sent:
        message = CompressedImage(format='png', header=to_msg(frame).header)
        message.data = array('B', cv2.imencode('.png', frame.grey)[1].tobytes())
        messages.append(message)
    cut = CompressedImage(format='png', data=messages[0].data[:50])
    graph.send([messages[0], cut, messages[1]])
    graph.codes_of(2)
    for message, frame in zip(graph.views, sent):
        np.testing.assert_array_equal(
            view_from_msg(message).pixels, Encoder(Config()).process(frame).view.pixels)
    _, values = graph.report(lambda values: values['received'] == '3')
    assert values['refused_malformed'] == '1'


def test_an_image_from_a_best_effort_camera_is_encoded(start, observer):
    graph = Graph(start, observer, '-p', 'qos_overrides./image.subscription.reliability:='
                  'best_effort')
    camera = observer.advertise(Image, 'image', reliability=ReliabilityPolicy.BEST_EFFORT)
    pending = map(to_msg, frames(1000))

    def encoded():  # the first ones may be lost while the two find each other
        camera.publish(next(pending))
        return graph.codes
    observer.spin_until(encoded)
