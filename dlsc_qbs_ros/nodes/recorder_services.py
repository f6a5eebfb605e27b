"""Services without arguments that may take their time."""

from __future__ import annotations

from concurrent.futures import Future
from typing import Callable, Mapping

from rclpy.node import Node
import rclpy.task
from std_srvs.srv import Trigger

from ..errors import DlscQbsError

Act = Callable[[], 'Future | None']


def offer_triggers(node: Node, prepare: Callable[[], None],
                   services: Mapping[str, tuple[Act, str]]) -> None:
    """
    Offer ~/`name` for each service: what it does, and its answer when that is done.

    `prepare` is called before each. What an act leaves to another thread is waited for.
    """
    for name, (act, done) in services.items():
        node.create_service(Trigger, f'~/{name}', _answer(node, prepare, act, done))


def _answer(node: Node, prepare: Callable[[], None], act: Act, done: str) -> Callable:
    async def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        prepare()
        try:
            future = act()
            if future is not None:
                await _finished(node, future)
                future.result()
            response.success, response.message = True, done
        except DlscQbsError as error:
            response.message = str(error)
        return response
    return answer


async def _finished(node: Node, future: Future) -> None:
    """Let the executor go on until the future of another thread is done."""
    finished = rclpy.task.Future(executor=node.executor)
    future.add_done_callback(lambda _: finished.set_result(None))
    await finished
