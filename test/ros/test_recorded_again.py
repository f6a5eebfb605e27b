"""What was recorded of a flight gives the mapper what the flight gave it."""

from dlsc_qbs_ros.cli.simulate import main as simulate
from dlsc_qbs_ros.config import Config
from dlsc_qbs_ros.core.types import GroundTruthSample
from dlsc_qbs_ros.io.flight import read_flight
from dlsc_qbs_ros.io.recordings.bag import read_bag
from dlsc_qbs_ros.pipeline.runner import run
import numpy as np

TOPICS = ['/camera/image_raw', '/odom']


def test_a_recording_of_a_replayed_flight_gives_the_poses_and_the_map_of_the_flight(
        start, tmp_path):
    flight, recording = tmp_path / 'flight', tmp_path / 'recording'
    assert simulate(['--flight', '2', '--seed', '0', '--seconds', '10', '--encoding', 'mono8',
                     '--out', str(flight)]) == 0
    recorder = start('nodes.recorder_node', *TOPICS, '-o', recording)
    assert start('cli.replay', flight, '--rate', 'max', '--topics', *TOPICS).wait() == 0
    assert recorder.stop() == 0
    for topic in TOPICS:
        assert ([message.data for message in read_bag(recording, [topic])]
                == [message.data for message in read_bag(flight, [topic])])
    was, now = (run((event for event in read_flight(path, *TOPICS)
                     if not isinstance(event, GroundTruthSample)), Config())
                for path in (flight, recording))
    for name in ('stamps_ns', 'poses', 'experiences', 'links', 'odometry'):
        np.testing.assert_array_equal(getattr(now, name), getattr(was, name))
    assert len(was.experiences) > 10
