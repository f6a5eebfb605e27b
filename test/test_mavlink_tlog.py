"""Recordings of a link: read whole, dirt and all; played in the time they took."""

from pathlib import Path

from dlsc_qbs_ros.config import MavlinkConfig, OdometryConfig
from dlsc_qbs_ros.errors import RecordingError
from dlsc_qbs_ros.io.mavlink.tlog import TlogOdometry, TlogPlayer
from dlsc_qbs_ros.pipeline.odometry import OdometryNormaliser
from mavlink_peer import attitude, heartbeat, odometry, Peer, position, wait_until
import pytest

START_US = 1_700_000_000_000_000
REAL = Path(__file__).parents[2] / 'shared' / 'data' / 'dronekit_flight.tlog'


def record(time_s, packet):
    return (START_US + round(time_s * 1e6)).to_bytes(8, 'big') + packet


def flight(n=20, first_s=0.0, boot_s=50.0, period_s=0.02):
    """Return records of ODOMETRY of a drone that goes north at 1 m/s."""
    peer = Peer()
    records = [record(first_s, peer.pack(heartbeat()))]
    for k in range(1, n + 1):
        time_s = k * period_s
        records.append(record(first_s + time_s, peer.pack(odometry(boot_s + time_s, x=time_s))))
    return records


@pytest.fixture
def write(tmp_path):
    def write_file(*records):
        path = tmp_path / 'flight.tlog'
        path.write_bytes(b''.join(records))
        return path
    return write_file


def test_the_stamps_are_those_of_the_recording(write):
    made = list(TlogOdometry(write(*flight())))
    assert [raw.sample.stamp_ns for raw in made] == pytest.approx(
        [START_US * 1000 + 20_000_000 * k for k in range(1, 21)], abs=2000)
    assert [raw.sample.pose.y_m for raw in made] == pytest.approx([0.02 * k for k in range(1, 21)])


def test_parts_are_joined_and_other_messages_left_alone(write):
    peer = Peer()
    records = [record(0.1 * k, peer.pack(message)) for k, message in enumerate([
        heartbeat(), attitude(1.0, yaw=0.1), position(1.1, x=3.0), attitude(1.2, yaw=0.3)])]
    raw, = TlogOdometry(write(*records))
    assert raw.sample.pose.y_m == 3.0


@pytest.mark.parametrize('dirt', [
    pytest.param(b'\xff' * 30, id='bytes'),
    pytest.param(b'\xfd' * 40, id='false starts'),
    pytest.param(record(0.1, b'\xfd\x09\x00'), id='cut'),
    pytest.param(record(-1e8, Peer().pack(heartbeat())), id='wild time')])
def test_dirt_costs_no_record_and_is_counted_once(write, dirt):
    records = flight()
    odometry = TlogOdometry(write(*records[:10], dirt, *records[10:]))
    assert len(list(odometry)) == 20
    assert odometry.counts == {'mavlink_corrupt': 1}


@pytest.mark.parametrize('n_before', [1, 10])
def test_records_from_before_the_clock_was_set_cost_none_of_those_after(write, n_before):
    records = flight()
    records[:n_before] = [(30_000_000 + 20_000 * k).to_bytes(8, 'big') + record[8:]
                          for k, record in enumerate(records[:n_before])]
    recording = TlogOdometry(write(*records))
    assert len(list(recording)) == 20
    assert recording.counts['mavlink_corrupt'] == 0


def test_a_recording_that_was_cut_is_read_up_to_there(write):
    odometry = TlogOdometry(write(*flight(), flight()[-1][:-3]))
    assert len(list(odometry)) == 20
    assert odometry.counts['mavlink_corrupt'] == 1


def test_a_reboot_in_a_recording_is_another_segment(write):
    normaliser = OdometryNormaliser(OdometryConfig())
    records = [*flight(), *flight(first_s=10.0, boot_s=3.0)]
    samples = [normaliser.accept(raw) for raw in TlogOdometry(write(*records))]
    assert [sample.segment for sample in samples] == 20 * [0] + 19 * [1]


def test_a_file_that_is_not_there_or_holds_nothing(write, tmp_path):
    with pytest.raises(RecordingError, match='gone.tlog: No such file'):
        TlogOdometry(tmp_path / 'gone.tlog')
    assert list(TlogOdometry(write(b'no recording at all'))) == []


def test_a_recording_is_played_in_its_time_and_ends_in_words(write):
    player, arrived = TlogPlayer(MavlinkConfig(connection=str(write(*flight(5))))), []
    player.start(arrived.append)
    wait_until(lambda: player.why_silent() == 'the recording has ended')
    player.stop()
    assert len(arrived) == 5
    assert player.diagnostics() == {}


def test_a_year_between_two_flights_is_not_waited_for(write):
    path = write(*flight(5), *flight(5, first_s=3e7, boot_s=5.0))
    player, arrived = TlogPlayer(MavlinkConfig(connection=str(path))), []
    player.start(arrived.append)
    wait_until(lambda: player.why_silent() == 'the recording has ended')
    player.stop()
    assert len(arrived) == 9
    assert player.diagnostics()['mavlink_time_outliers'] == 1  # alone, it was no reboot yet


def test_a_recording_stops_when_it_is_told_to(write):
    path = write(*flight(2, period_s=1000.0))
    player, arrived = TlogPlayer(MavlinkConfig(connection=str(path))), []
    player.start(arrived.append)
    wait_until(lambda: arrived)
    player.stop()
    assert len(arrived) == 1


def test_a_real_dirty_recording_is_read():
    if not REAL.is_file():
        pytest.skip(f'{REAL} is not here')
    odometry, normaliser = TlogOdometry(REAL), OdometryNormaliser(OdometryConfig())
    samples = [normaliser.accept(raw) for raw in odometry]
    assert len(samples) == 1161 and None not in samples
    assert {sample.segment for sample in samples} == {0}
    assert odometry.counts['mavlink_reboots'] == 1
