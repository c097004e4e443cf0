"""The topics of a stgdat run for Python: how to join a run and open its topics.

Needs Python 3.10 and `pip install iceoryx2==0.10.0`. The layouts are in `stgdat_wire.py`, which `stgdat wire --python`
prints. Copy both files. iceoryx2 refuses to connect to a run of another version.

The contract
* World frame: positions are in metres in one fixed, right-handed frame (x, y; z up), within 32 km of its origin.
  `origin` is the position of this origin in the frame of map and detections (`stgdat run --origin X,Y`): producers
  subtract it, and consumers add it. Headings are counter-clockwise from +x, in radians. Velocities are in the world
  frame, not relative to the ego vehicle.
* Ego pose: `ego_m` and `ego_heading_rad` of a frame are the vehicle's pose in the world frame at the stamp. For a fixed
  sensor they are the scene's centre and 0. If there are too many agents, the ones nearest to the ego are kept.
* Time base: `stamp_ns` is the time at which the detections are valid, on the sensor's clock. Each frame has a different
  stamp, and a frame may be late. All algorithms use only this time. `released_ns` and the hops are CLOCK_MONOTONIC
  (`time.monotonic_ns()`) and only measure latency.
* `seq` counts ticks from 0 without gaps. A gap counts as a lost frame. Frames come every `interval_ns`, at least 80 ms.
"""

import functools
import glob
import os
import socket
import time

import iceoryx2 as iox2
from stgdat_wire import TOPICS, Header


def run_folder():
    """The folder of the run in the environment, or else of this user's newest run on this machine."""
    if root := os.environ.get("STGDAT_ROOT"):
        return root
    # The lock of a run contains the path of its folder.
    locks = [lock for lock in glob.glob("/dev/shm/stgdat_????????_????????_lock") if os.stat(lock).st_uid == os.geteuid()]
    if not locks:
        raise SystemExit("no run of yours is to be found: start one with `stgdat run`")
    return open(max(locks, key=os.path.getmtime)).read()


@functools.cache
def origin():
    """x and y of the world frame's origin in the frame of map and detections, m: (0, 0) without `--origin`."""
    text = os.environ.get("STGDAT_ORIGIN") or open(os.path.join(run_folder(), "origin")).read()
    return tuple(map(float, text.split(",")))


def join(name):
    """A node in the run of the environment, or else in the newest run on this machine."""
    root = run_folder()
    iox2.set_log_level(iox2.LogLevel.Error)
    config = iox2.config.global_config()
    config.global_cfg.prefix = iox2.FileName.new(os.environ.get("STGDAT_PREFIX") or open(os.path.join(root, "prefix")).read())
    config.global_cfg.root_path = iox2.Path.new(root)
    # A node that cleans up after others can hang on half-made resources of a killed node. The launcher cleans up.
    config.global_cfg.node.cleanup_dead_nodes_on_creation = False
    config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
    config.global_cfg.service.cleanup_dead_nodes_on_open = False
    return iox2.NodeBuilder.new().name(iox2.NodeName.new(name)).config(config).create(iox2.ServiceType.Ipc)


def await_turn():
    """If this process replaces a running one (`stgdat stage replace`), waits until that process has ended.

    Call this after the inputs are open and large files are loaded, and before the outputs are opened."""
    path = os.environ.get("STGDAT_STANDBY")
    if path is None:
        return
    with socket.socket(socket.AF_UNIX) as launcher:
        launcher.connect(path)
        launcher.sendall(f"ready {os.environ['STGDAT_STAGE']} {os.environ['STGDAT_INCARNATION']}\n".encode())
        if launcher.makefile().readline().strip() != "go":
            raise SystemExit("the launcher is gone")


def topic(node, name, patience_s=10):
    """The two services of a topic, created by its stages: frames, and the events that wake their readers."""
    service = lambda: node.service_builder(iox2.ServiceName.new(f"stgdat/{name}"))
    until = time.monotonic() + patience_s
    while True:
        try:
            frames = service().publish_subscribe(iox2.Slice[TOPICS[name]]).user_header(Header)
            return frames.payload_alignment(iox2.Alignment.new(64)).open(), service().event().open()
        except (iox2.PublishSubscribeOpenError, iox2.EventOpenError):
            if time.monotonic() > until:
                raise
            time.sleep(0.05)


def reader(node, name, depth=2, patience_s=2):
    """The reading ends of a topic: frames and events. Waits if all places are taken, because the place of a dead reader
    is free again within a second."""
    frames, events = topic(node, name)
    until = time.monotonic() + patience_s
    while True:
        try:
            return frames.subscriber_builder().buffer_size(depth).create(), events.listener_builder().create()
        except (iox2.SubscriberCreateError, iox2.ListenerCreateError) as error:
            if not str(error).startswith("ExceedsMaxSupported"):
                raise
            if time.monotonic() > until:
                raise SystemExit(
                    f'all {frames.static_config.max_subscribers} places for readers of topic "{name}" are taken: end one of '
                    f"them, or add places with `readers = {{ {name} = 2 }}` above the first [[stage]] of pipeline.toml"
                ) from None
            time.sleep(0.05)
