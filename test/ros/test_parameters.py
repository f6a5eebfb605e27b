"""A node's parameters are the package's own: declared with their ranges, all others refused."""

from dlsc_qbs_ros.config import Config, PARAMETERS
from dlsc_qbs_ros.errors import ConfigError
from dlsc_qbs_ros.ros.parameters import NodeParameters
from dlsc_qbs_ros.ros.qos import adapted_to, create_subscription, IMAGE_INPUT, qos_to_words
import pytest
import rclpy
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from std_msgs.msg import String

SECTIONS = ('view', 'recorder')


@pytest.fixture
def make_node(domain_id):
    """Give a function that makes a node from ROS arguments."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain_id)
    nodes = []

    def make(*ros_args):
        nodes.append(Node('node', context=context, use_global_arguments=False,
                          cli_args=['--ros-args', *ros_args]))
        return nodes[-1]
    yield make
    for node in nodes:
        node.destroy_node()
    context.shutdown()


@pytest.fixture
def load(make_node):
    """Give a function that loads the configuration of a node from ROS arguments."""
    return lambda *ros_args: declare(make_node(*ros_args)).load()


def declare(node, sections=SECTIONS, on_change=None):
    return NodeParameters(node, sections, on_change)


def set_parameters(node, values):
    """Set parameters together; return why not, or nothing."""
    return node.set_parameters_atomically(
        [Parameter(name, value=value) for name, value in values.items()]).reason


def test_a_node_without_arguments_has_the_defaults(load):
    assert load() == Config()


def test_values_are_taken_from_arguments(load):
    config = load('-p', 'view.width:=20', '-p', 'recorder.topics:=[/a, /b]')
    assert config == Config().override({'view.width': 20, 'recorder.topics': ('/a', '/b')})


def test_one_file_serves_all_nodes(load, tmp_path):
    profile = tmp_path / 'profile.yaml'
    profile.write_text(
        '/**:\n  ros__parameters:\n    view: {width: 20}\n    recorder: {topics: []}\n'
        '    encoder: {eta_c: 1e-3}\n    use_sim_time: true\n')
    assert load('--params-file', str(profile)) == Config().override(
        {'view.width': 20, 'encoder.eta_c': 1e-3})


def test_an_integer_serves_as_a_double(load):
    crop_top = load('-p', 'view.crop_top:=0').view.crop_top
    assert crop_top == 0.0 and isinstance(crop_top, float)


@pytest.mark.parametrize('assignment, error', [
    ('view.widht:=20', "unknown parameter 'view.widht' .value 20."),
    ('whatever:=[]', "unknown parameter 'whatever'"),
    ('view.width:=3', r'view.width = 3: expected a value in \[4, 4096\]'),
    ('view.width:=wide', "view.width = 'wide': expected int"),
    ('view.width:=[]', r'view.width = \(\): expected int'),
    ('view.crop_top:=.nan', 'view.crop_top = nan: expected a finite number'),
    ('recorder.topics:=[1, 2]', 'recorder.topics = '),
    ('encoder.mode:=fast', "encoder.mode = 'fast': expected one of epochs, paper")])
def test_what_does_not_fit_is_refused(load, assignment, error):
    with pytest.raises(ConfigError, match=error):
        load('-p', assignment)


@pytest.mark.parametrize('assignment', [
    'use_sim_time:=true', 'qos_overrides./image.subscription.depth:=3'])
def test_parameters_of_ros_itself_pass(load, assignment):
    assert load('-p', assignment) == Config()


def test_a_node_declares_its_own_sections(make_node):
    node = make_node()
    declare(node)
    declared = {name for name in PARAMETERS if node.has_parameter(name)}
    assert declared == {name for name in PARAMETERS if name.split('.')[0] in SECTIONS}


def test_a_parameter_describes_itself(make_node):
    node = make_node('-p', 'view.width:=20')
    declare(node, ('view', 'encoder'))
    width, share, mode = map(
        node.describe_parameter, ('view.width', 'view.crop_top', 'encoder.mode'))
    assert width.description == 'width of the view [px]'
    assert (width.integer_range[0].from_value, width.integer_range[0].to_value) == (4, 4096)
    assert (share.floating_point_range[0].from_value,
            share.floating_point_range[0].to_value) == (0.0, 0.9)
    assert mode.additional_constraints == 'one of epochs, paper'
    assert node.get_parameter('view.width').value == 20


def test_what_was_given_wrong_is_put_right_before_it_is_loaded(make_node):
    node = make_node('-p', 'view.width:=1', '-p', 'recorder.topics:=[/a]')
    parameters = declare(node)
    with pytest.raises(ConfigError, match='view.width = 1'):
        parameters.load()
    assert set_parameters(node, {'view.width': 20}) == ''
    assert parameters.load() == Config().override(
        {'view.width': 20, 'recorder.topics': ('/a',)})


def test_before_it_is_loaded_a_value_is_checked_by_itself_then_all_together(make_node):
    node = make_node()
    parameters = declare(node)
    assert set_parameters(node, {'view.crop_top': 0.95})
    assert set_parameters(node, {'view.crop_top': 0.5}) == ''
    assert set_parameters(node, {'view.crop_bottom': 0.5}) == ''
    with pytest.raises(ConfigError, match='view.crop_top . view.crop_bottom = 1'):
        parameters.load()


def test_once_loaded_only_live_parameters_change(make_node):
    node, configs = make_node(), []
    parameters = declare(node, ('view', 'ratslam', 'odometry'), configs.append)
    parameters.load()
    assert set_parameters(node, {'view.width': 20}) == (
        'view.width cannot change while the node is configured: codes made with another could '
        'not be compared; deactivate and clean up first')
    assert node.get_parameter('view.width').value == Config().view.width
    changes = {'ratslam.threshold': 0.9, 'odometry.yaw_noise': 0.1}
    assert set_parameters(node, changes) == ''
    assert configs == [Config().override(changes)]  # once for both


def test_parameters_set_together_change_all_or_none(make_node):
    node, configs = make_node(), []
    declare(node, ('view', 'ratslam'), configs.append).load()
    assert set_parameters(node, {'ratslam.threshold': 0.9, 'view.width': 20})
    assert node.get_parameter('ratslam.threshold').value == Config().ratslam.threshold
    assert configs == []


def test_a_value_set_to_what_it_is_changes_nothing_and_is_accepted(make_node):
    node = make_node()
    declare(node, on_change=lambda config: None).load()
    assert set_parameters(node, {'view.width': Config().view.width}) == ''


def test_once_released_all_parameters_change_again(make_node):
    node = make_node()
    parameters = declare(node)
    parameters.load()
    parameters.release()
    assert set_parameters(node, {'view.width': 20}) == ''
    assert parameters.load().view.width == 20


def test_the_quality_of_service_may_be_overridden(make_node):
    node = make_node('-p', 'qos_overrides./image.subscription.reliability:=reliable',
                     '-p', 'qos_overrides./image.subscription.depth:=7')
    qos = create_subscription(node, String, 'image', lambda msg: None, IMAGE_INPUT).qos_profile
    assert (qos.reliability, qos.depth) == (ReliabilityPolicy.RELIABLE, 7)
    other = create_subscription(node, String, 'other', lambda msg: None, IMAGE_INPUT).qos_profile
    assert other.reliability == ReliabilityPolicy.BEST_EFFORT


@pytest.mark.parametrize('assignment', ['reliability:=perfect', 'depth:=deep'])
def test_an_override_that_does_not_fit_is_refused(make_node, assignment):
    node = make_node('-p', f'qos_overrides./image.subscription.{assignment}')
    with pytest.raises(ConfigError, match="qos_overrides of topic 'image': "):
        create_subscription(node, String, 'image', lambda msg: None, IMAGE_INPUT)


RELIABLE = QoSProfile(depth=1)
BEST_EFFORT = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


@pytest.mark.parametrize('offers, reliability, durability', [
    ([RELIABLE], 'reliable', 'volatile'),
    ([BEST_EFFORT], 'best_effort', 'volatile'),
    ([RELIABLE, BEST_EFFORT], 'best_effort', 'volatile'),
    ([LATCHED], 'reliable', 'transient_local'),
    ([LATCHED, RELIABLE], 'reliable', 'volatile')])
def test_a_subscription_adapts_to_every_offer(offers, reliability, durability):
    words = qos_to_words(adapted_to(offers, depth=5))
    assert (words['reliability'], words['durability']) == (reliability, durability)
