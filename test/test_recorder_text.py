"""What the recorder says on a terminal: a line while it records, a table at the end."""

import os

from dlsc_qbs_ros.io.recordings.ledger import RecordingStatus, TopicCounts
from dlsc_qbs_ros.nodes.recorder_losses import Losses
from dlsc_qbs_ros.nodes.recorder_text import show, status_line, summary
import pytest

TOPICS = {'/image': TopicCounts(1200, 3, 0), '/odom': TopicCounts(1, 0, 0)}
LOSSES = {'/odom': Losses((0,), 0, 0, 0), '/image': Losses((2,), 0, 3, 0),
          '/silent': Losses((), 0, 0, 0)}


def status(state='recording', error='', topics=TOPICS):
    return RecordingStatus(state, error, 2, 1_234_567, 0, topics)


@pytest.mark.parametrize('status, is_paused, line', [
    (status(), False, 'recording  1:01:01  3 topics  1201 messages, 1.23 MB  5 lost'),
    (status(), True, 'paused  1:01:01  3 topics  1201 messages, 1.23 MB  5 lost'),
    (status('stopped', 'disk full'), True,
     'stopped  1:01:01  3 topics  1201 messages, 1.23 MB  5 lost  disk full')])
def test_the_line_tells_state_size_and_losses(status, is_paused, line):
    assert status_line(3661.9, status, LOSSES, is_paused) == line


def test_a_line_stays_within_its_row_and_the_next_takes_its_place(capsys, monkeypatch):
    monkeypatch.setattr('shutil.get_terminal_size', lambda: os.terminal_size((10, 5)))
    show('0123456789')
    assert capsys.readouterr().err == '012345678\x1b[K\r'


def test_the_summary_tells_what_there_is_and_what_is_missing_topic_by_topic():
    assert summary('bag', 59.9, status(), LOSSES, {'/odd': 'no definition'}) == '\n'.join([
        '  messages    lost  topic',
        '      1200       5  /image',
        '         1       0  /odom',
        '         0       0  /silent',
        '/odd is not recorded: no definition',
        'bag: 1201 messages, 1.23 MB in 2 files, 0:00:59, 5 lost'])


def test_one_of_a_thing_is_said_so():
    line = status_line(0.0, status(topics={'/a': TopicCounts(1)}), {'/a': LOSSES['/odom']}, False)
    assert line.startswith('recording  0:00:00  1 topic  1 message, ')
