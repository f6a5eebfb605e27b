"""Services say what was done or why not, and nothing waits for one that takes its time."""

from concurrent.futures import Future
import threading

from dlsc_qbs_ros.errors import MapError
from dlsc_qbs_ros.nodes.services import finished, offer
from dlsc_qbs_ros.ros.managed_node import ManagedNode
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import SetBool, Trigger


class Worker(ManagedNode):
    """A node that works on what it is given, another thread's work, for as long as that takes."""

    def __init__(self):
        super().__init__('worker', ())
        self.given = []
        self.n_ticks = 0

    def configure(self, config, undo):
        offer(self, Trigger, 'work', self._work)
        offer(self, Trigger, 'refuse', self._refuse)
        offer(self, SetBool, 'switch', lambda is_on: f'switched {"on" if is_on else "off"}')
        self.create_service(Trigger, '~/block', self._block)
        self.create_timer(0.01, self._tick)

    def activate(self, undo):
        pass

    def report(self):
        return b'\0', '', {}

    async def _work(self):
        self.given.append(Future())
        return await finished(self, self.given[-1])

    async def _block(self, request, response):
        await self._work()

    def _refuse(self):
        raise MapError('no map')

    def _tick(self):
        self.n_ticks += 1


@pytest.fixture
def worker(domain_id, spinning):
    return spinning(Worker)


def ask(observer, srv_type, service, **fields):
    """Call a service and do not wait for its answer."""
    client = observer.node.create_client(srv_type, f'/worker/{service}')
    observer.spin_until(client.service_is_ready)
    return client.call_async(srv_type.Request(**fields))


def test_the_answer_is_what_was_done_or_why_not(worker, observer):
    for service, fields, answer in (('switch', {'data': True}, (True, 'switched on')),
                                    ('switch', {'data': False}, (True, 'switched off')),
                                    ('refuse', {}, (False, 'no map'))):
        response = observer.call(
            SetBool if fields else Trigger, f'/worker/{service}', **fields)
        assert (response.success, response.message) == answer


def test_while_a_service_works_all_else_goes_on(worker, observer):
    answer = ask(observer, Trigger, 'work')
    observer.spin_until(lambda: worker.given)
    n_ticks = worker.n_ticks
    observer.spin_until(lambda: worker.n_ticks > n_ticks)
    assert observer.call(SetBool, '/worker/switch', data=True).success
    assert not answer.done()
    worker.given[0].set_result('done')
    observer.spin_until(answer.done)
    assert answer.result().message == 'done'


def test_calls_of_one_service_come_one_by_one(worker, observer):
    first = ask(observer, Trigger, 'work')
    observer.spin_until(lambda: worker.given)
    second = ask(observer, Trigger, 'work')
    assert observer.call(SetBool, '/worker/switch', data=True).success
    assert len(worker.given) == 1
    worker.given[0].set_exception(MapError('too old'))
    observer.spin_until(lambda: len(worker.given) == 2)
    worker.given[1].set_result('done')
    observer.spin_until(lambda: first.done() and second.done())
    assert (first.result().message, second.result().message) == ('too old', 'done')


def test_who_waits_for_another_thread_needs_no_timer_to_go_on(observer):
    executor, work = SingleThreadedExecutor(context=observer.node.context), Future()
    node = rclpy.create_node('quiet', context=observer.node.context)
    executor.add_node(node)
    task = executor.create_task(finished(node, work))
    threading.Timer(0.3, work.set_result, ['done']).start()
    executor.spin_until_future_complete(task, 30.0)
    assert task.done() and task.result() == 'done'
    executor.shutdown()
    node.destroy_node()


def test_a_node_that_is_cleaned_up_owes_no_answer(worker, observer):
    ask(observer, Trigger, 'work')
    observer.spin_until(lambda: worker.given)
    work = worker.given[0]
    assert observer.transition('worker', 'deactivate')
    assert observer.transition('worker', 'cleanup')
    work.set_result('done')
    assert observer.transition('worker', 'configure')
    assert observer.call(SetBool, '/worker/switch', data=True).success


def test_a_node_ends_while_a_callback_of_its_own_waits(worker, observer):
    ask(observer, Trigger, 'block')
    observer.spin_until(lambda: worker.given)
    n_ticks = worker.n_ticks
    assert observer.call(SetBool, '/worker/switch', data=True).success
    assert worker.n_ticks == n_ticks  # that much is held up, but not the end
