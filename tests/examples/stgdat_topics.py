"""The topics of a stgdat run for Python: the layouts of `shared/wire` and how to join a run.

Needs Python 3.10, `pip install iceoryx2==0.10.0`. Every structure has the size and the type name of its Rust twin;
iceoryx2 refuses to connect where they differ.

The contract
* World frame: positions in metres in one fixed, right-handed frame (x, y; z up) whose origin lies within 32 km;
  headings counter-clockwise from +x, radians; velocities in the world frame, not relative to the ego vehicle.
* Ego pose: `ego_m` and `ego_heading_rad` of each frame are the vehicle's pose in that frame at the stamp, or the scene's
  centre and 0 for a fixed sensor. When there are more agents than fit, the nearest to it are kept.
* Time base: `stamp_ns` is the time at which the detections are valid, on the sensor's clock, no two alike (a frame may
  come late); all algorithms use it alone. `released_ns` and the hops are CLOCK_MONOTONIC (`time.monotonic_ns()`) and used for latency alone.
* `seq` counts ticks from 0 without gaps; a gap counts as a lost frame. Frames come every `interval_ns`, at least 80 ms.
"""

import ctypes as c
import glob
import os
import time

import iceoryx2 as iox2

SCHEMA = 1
WARM_UP, END, SEEN_FROM_EGO = 1, 2, 32
SOURCE = 1
VEHICLE, CYCLIST, PEDESTRIAN = range(3)
HAS_ID, HAS_HEADING, HAS_SPEED, HAS_SIZE = 1, 2, 4, 8
AGENTS_MAX, DETECTIONS_MAX, HORIZON_MAX, MODES_MAX = 128, 512, 12, 20


def layout(type_name, size, **fields):
    """A ctypes structure of `fields` in order, named for iceoryx2; its size is checked."""
    of = type(type_name.split(".")[1].title(), (c.Structure,), {"_fields_": list(fields.items())})
    of.type_name = staticmethod(lambda: type_name)
    assert c.sizeof(of) == size, (type_name, c.sizeof(of), size)
    return of


Hop = layout("stgdat.hop", 40, stage=c.c_uint32, incarnation=c.c_uint32, received_ns=c.c_uint64,
             started_ns=c.c_uint64, finished_ns=c.c_uint64, sent_ns=c.c_uint64)
Counts = layout("stgdat.counts", 24, agents_len=c.c_uint32, history_len=c.c_uint32, horizon_len=c.c_uint32,
                modes_len=c.c_uint32, patch_side=c.c_uint32, edges_len=c.c_uint32)
Header = layout("stgdat.header.v1", 424, schema=c.c_uint32, flags=c.c_uint32, run_id=c.c_uint64, seq=c.c_uint64,
                stamp_ns=c.c_int64, released_ns=c.c_uint64, interval_ns=c.c_uint64, step_ns=c.c_uint64,
                observed_types=c.c_uint32, left_out_len=c.c_uint32, ego_m=c.c_float * 2, ego_heading_rad=c.c_float,
                hops_len=c.c_uint32, counts=Counts, hops=Hop * 8)
Detection = layout("stgdat.detections.v1", 48, id=c.c_uint64, x_m=c.c_float, y_m=c.c_float, heading_rad=c.c_float,
                   speed_mps=c.c_float, length_m=c.c_float, width_m=c.c_float, score=c.c_float, sigma_m=c.c_float,
                   agent_type=c.c_uint32, flags=c.c_uint32)
Truth = layout("stgdat.truth.v1", 24, id=c.c_uint64, agent_type=c.c_uint32, x_m=c.c_float, y_m=c.c_float,
               reserved=c.c_uint32)
Path = c.c_float * 2 * HORIZON_MAX
Control = layout("stgdat.control", 20, mean=c.c_float * 2, cholesky=c.c_float * 3)
Forecast = layout("stgdat.forecasts.v2", 7224, id=c.c_uint64, source_id=c.c_uint64, age_ns=c.c_uint64,
                  prior_age_ns=c.c_uint64, agent_type=c.c_uint32, quality=c.c_uint32, cause=c.c_uint32, modes_len=c.c_uint32, x_m=c.c_float,
                  y_m=c.c_float, vx_mps=c.c_float, vy_mps=c.c_float, heading_rad=c.c_float, length_m=c.c_float,
                  width_m=c.c_float, prior=c.c_uint32, steering=c.c_uint32, frame_heading_rad=c.c_float,
                  probability=c.c_float * MODES_MAX, modes=Path * MODES_MAX, best=Path, mean=Path,
                  covariance=c.c_float * 3 * HORIZON_MAX, controls=Control * HORIZON_MAX * MODES_MAX)


def join(name):
    """A node in the run that `stgdat run` tells of by environment, else in the newest run of this machine."""
    roots = [os.environ.get("STGDAT_ROOT"), *sorted(glob.glob("/tmp/stgdat_????????"), key=os.path.getmtime)[::-1]]
    root = next(filter(None, roots), None)
    if root is None:
        raise SystemExit("no run of stgdat is to be found: start one with `stgdat run`")
    iox2.set_log_level(iox2.LogLevel.Error)
    config = iox2.config.global_config()
    config.global_cfg.prefix = iox2.FileName.new(os.environ.get("STGDAT_PREFIX") or os.path.basename(root) + "_")
    config.global_cfg.root_path = iox2.Path.new(root)
    # A node that cleans up after others may hang on what a killed one left half made; the launcher does it.
    config.global_cfg.node.cleanup_dead_nodes_on_creation = False
    config.global_cfg.node.cleanup_dead_nodes_on_destruction = False
    config.global_cfg.service.cleanup_dead_nodes_on_open = False
    return iox2.NodeBuilder.new().name(iox2.NodeName.new(name)).config(config).create(iox2.ServiceType.Ipc)


def topic(node, name, element, patience_s=10):
    """The two services of a topic, as its stages made them: frames, and the events that wake their readers."""
    service = lambda: node.service_builder(iox2.ServiceName.new(f"stgdat/{name}"))
    until = time.monotonic() + patience_s
    while True:
        try:
            frames = service().publish_subscribe(iox2.Slice[element]).user_header(Header)
            return frames.payload_alignment(iox2.Alignment.new(64)).open(), service().event().open()
        except (iox2.PublishSubscribeOpenError, iox2.EventOpenError):
            if time.monotonic() > until:
                raise
            time.sleep(0.05)
