"""The encoder node, as a process: codes carry the stamps of images, and no image kills it."""

from array import array
from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.mosaic import mosaic
from dlsc_qbs_ros.core.types import Frame
from dlsc_qbs_ros.nodes import encoder_scope
from dlsc_qbs_ros.pipeline.encoder import Encoder
from dlsc_qbs_ros.ros.conversions import code_from_msg, dictionary_from_msg, view_from_msg
from dlsc_qbs_ros.ros.image_conversions import image_to_grey, image_to_msg
from dlsc_qbs_ros.ros.stamps import stamp_to_ns
import numpy as np
import pytest
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, Image, JointState

RELIABLE = ['-p', 'qos_overrides./image.subscription.reliability:=reliable',
            '-p', 'qos_overrides./image.subscription.depth:=1000']
PERIOD_NS = 100_000_000
START_NS = 1_600_000_000_000_000_000


def frames(n, seed=0):
    rng = np.random.default_rng(seed)
    return [Frame(START_NS + k * PERIOD_NS, rng.integers(0, 256, (65, 86), dtype=np.uint8))
            for k in range(n)]


def stamp_of(msg):
    return stamp_to_ns(msg.header.stamp)


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


def test_the_report_holds_the_step_size_against_its_limit(graph):
    encoder, sent = Encoder(Config()), frames(10)
    for frame in sent:
        encoder.process(frame)
    graph.send(map(to_msg, sent))
    level, values = graph.report(lambda values: values['encoded'] == '10')
    assert (level, values['ran_away']) == (DiagnosticStatus.OK, '0')
    assert float(values['lambda_max']) == pytest.approx(encoder.lambda_max, rel=1e-5)
    assert values['lambda_max_limit'] == '128'  # 2 / eta_c, which is 1 / n_atoms for patches


@pytest.mark.parametrize('protection', [True, False])
def test_learning_that_runs_away_is_reported(start, observer, protection):
    graph = Graph(start, observer, '-p', 'encoder.eta_d:=1.0', '-p', 'encoder.mode:=paper',
                  '-p', 'encoder.input:=image', '-p', f'encoder.protection:={protection}'.lower())
    graph.send(map(to_msg, frames(20)))
    _, values = graph.report(lambda values: values['encoded'] == '20')
    messages = ', '.join(report.status[0].message for report in graph.reports)
    # Protected, the learner has gone back to where it was well.
    assert (int(values['ran_away']) > 0) == protection == ('ran away' in messages)
    assert (float(values['lambda_max']) < 400.0) == protection
    assert ('lambda_max' in messages) != protection


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


def test_an_encoder_set_inactive_is_deaf_and_goes_on_with_what_it_has_learned(graph):
    sent = frames(30)
    graph.send(map(to_msg, sent[:10]))
    graph.codes_of(10)
    assert graph.observer.transition('encoder', 'deactivate')
    graph.send(map(to_msg, sent[10:20]))
    assert graph.observer.transition('encoder', 'activate')
    graph.observer.spin_until(graph.images.get_subscription_count)
    graph.send(map(to_msg, sent[20:]))

    encoder = Encoder(Config())
    expected = [encoder.process(frame).code for frame in sent[:10] + sent[20:]]
    for code, e in zip(graph.codes_of(20), expected):
        assert code.stamp_ns == e.stamp_ns
        np.testing.assert_array_equal(code.values, e.values)
    _, values = graph.report(lambda values: values.get('received') == '20')
    assert values['lost'] == '0'


def test_the_scalars_of_each_frame_are_those_of_the_pipeline(start, observer):
    learning = observer.collect(JointState, 'learning')
    graph, sent = Graph(start, observer), frames(30)
    graph.send(map(to_msg, sent))
    observer.spin_until(lambda: learning and stamp_of(learning[-1]) == sent[-1].stamp_ns)

    encoder = Encoder(Config())
    expected = [encoder.process(frame) for frame in sent]
    assert {e.learned for e in expected} == {True, False}
    expected = expected[-len(learning):]  # the first may be lost while the two find each other
    assert [stamp_of(message) for message in learning] == [e.code.stamp_ns for e in expected]
    for message, e in zip(learning, expected):
        assert dict(zip(message.name, message.position)) == {
            'reprojection_error': e.reprojection_error, 'surprise': e.surprise,
            'gate': e.learned, 'epoch': e.epoch}


def test_the_dictionary_image_shows_the_atoms_as_the_frame_of_its_stamp_left_them(
        start, observer):
    pictures = observer.collect(Image, 'dictionary_image')
    graph, sent = Graph(start, observer), frames(1000)
    pending = map(to_msg, sent)

    def shown():
        graph.images.publish(next(pending))
        return pictures
    observer.spin_until(shown)

    encoder, picture = Encoder(Config()), pictures[0]
    for frame in sent[:(stamp_of(picture) - START_NS) // PERIOD_NS + 1]:
        encoder.process(frame)
    # Patches of 5 x 5 pixels, each pixel six times as large.
    assert (picture.encoding, picture.height, picture.width) == ('mono8', 6 * 47, 6 * 47)
    np.testing.assert_array_equal(
        image_to_grey(picture)[::6, ::6], mosaic(encoder.atoms, 5, 5))


def test_the_names_of_what_is_shown_are_relative(start, observer):
    start('nodes.encoder_node', '--ros-args', '-r', '__ns:=/drone')
    observer.spin_until(lambda: all(observer.node.count_publishers(f'/drone/{topic}')
                                    for topic in ('learning', 'dictionary_image')))


class Scope:
    """An encoder's scope in the test's own process, and the stamps of what it has built."""

    def __init__(self, observer, monkeypatch, **overrides):
        self.now_s = 1e6
        self.scalars, self.pictures = [], []
        for name, built in (('scalars_to_msg', self.scalars), ('atoms_to_msg', self.pictures)):
            monkeypatch.setattr(
                encoder_scope, name, self._noted(getattr(encoder_scope, name), built))
        monkeypatch.setattr(
            encoder_scope, 'time', SimpleNamespace(monotonic=lambda: self.now_s))
        config = Config().override({f'encoder.{key}': value for key, value in overrides.items()})
        self._encoder = Encoder(config)
        self._scope = encoder_scope.EncoderScope(observer.node, self._encoder)

    def _noted(self, to_msg, built):
        def build(stamp_ns, *args):
            built.append(stamp_ns)
            return to_msg(stamp_ns, *args)
        return build

    def show(self, frame):
        """Return the frame's stamp when the frame has started an epoch."""
        encoded = self._encoder.process(frame)
        self._scope.show(encoded)
        return encoded.dictionary and encoded.code.stamp_ns


def watch(observer, msg_type, topic):
    observer.collect(msg_type, topic)
    observer.spin_until(lambda: observer.node.count_subscribers(topic))


def look_away(observer):
    for subscription in list(observer.node.subscriptions):
        observer.node.destroy_subscription(subscription)
    for topic in ('learning', 'dictionary_image'):
        observer.spin_until(lambda: not observer.node.count_subscribers(topic))


def test_nothing_is_built_that_nobody_subscribes_to(observer, monkeypatch):
    scope, (a, b, c, d) = Scope(observer, monkeypatch), frames(4)
    scope.show(a)
    assert (scope.scalars, scope.pictures) == ([], [])
    watch(observer, JointState, 'learning')
    scope.show(b)
    assert (scope.scalars, scope.pictures) == ([b.stamp_ns], [])
    watch(observer, Image, 'dictionary_image')
    scope.show(c)
    assert (scope.scalars, scope.pictures) == ([b.stamp_ns, c.stamp_ns], [c.stamp_ns])
    look_away(observer)
    scope.now_s += 10.0
    scope.show(d)
    assert (scope.scalars, scope.pictures) == ([b.stamp_ns, c.stamp_ns], [c.stamp_ns])


def test_a_picture_is_made_once_a_second_of_wall_time(observer, monkeypatch):
    scope, sent = Scope(observer, monkeypatch, mode='paper'), frames(30)
    watch(observer, Image, 'dictionary_image')
    for frame in sent:
        scope.show(frame)
        scope.now_s += 0.125
    assert scope.pictures == [frame.stamp_ns for frame in sent[::8]]


def test_a_picture_is_made_when_an_epoch_starts(observer, monkeypatch):
    scope = Scope(observer, monkeypatch, epoch_change=0.01)
    watch(observer, Image, 'dictionary_image')
    epochs = [stamp for stamp in map(scope.show, frames(30)) if stamp is not None]
    assert len(epochs) > 1
    assert scope.pictures == epochs
