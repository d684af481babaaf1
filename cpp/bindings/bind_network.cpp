#include "bindings.hpp"
#include "burrlab/network/publisher.hpp"
#include "burrlab/network/replica.hpp"

namespace py = pybind11;
using namespace burrlab;

namespace {

using Tools = std::vector<std::pair<Burr, Material>>;

/// A publisher with the follower that it listens to.
struct BoundPublisher {
  std::shared_ptr<Follower> follower;
  std::shared_ptr<Publisher> publisher;
};

/// Text of a peer, which may be no UTF-8.
py::str text_of(const std::string& bytes) {
  PyObject* text = PyUnicode_DecodeUTF8(bytes.data(), static_cast<py::ssize_t>(bytes.size()), "replace");
  if (!text) throw py::error_already_set();
  return py::reinterpret_steal<py::str>(text);
}

py::dict to_dict(const openigtlink::Counters& counters) {
  py::dict dropped;
  for (std::size_t i = 0; i < counters.dropped.size(); ++i)
    if (counters.dropped[i]) dropped[openigtlink::drop_name(openigtlink::Drop(i))] = counters.dropped[i];
  return dropped;
}

py::dict to_dict(const PublisherStatus& s) {
  py::dict out;
  out["tick"] = s.tick;
  out["standard_peers"] = s.standard_peers;
  out["replicas"] = s.replicas;
  out["accepted"] = s.accepted;
  out["refused"] = s.refused;
  out["skipped"] = s.skipped;
  out["cut_off"] = s.cut_off;
  out["stalled"] = s.stalled;
  out["hellos"] = s.hellos;
  out["by_ticks"] = s.by_ticks;
  out["by_bricks"] = s.by_bricks;
  out["bad_words"] = s.bad_words;
  out["ignored"] = s.ignored;
  out["framing_lost"] = s.framing_lost;
  out["too_many_faults"] = s.too_many_faults;
  out["out_of_range"] = s.out_of_range;
  out["bytes_sent"] = s.bytes_sent;
  out["messages"] = s.received.messages;
  out["dropped"] = to_dict(s.received);
  return out;
}

py::dict to_dict(const ReplicaStatus& s, const Replica& replica) {
  py::list faults, divergences;
  for (const ReplicaFault& fault : s.last_faults)
    faults.append(py::make_tuple(fault.tick, fault.seen, fault.reason));
  for (const Divergence& divergence : s.divergences) {
    py::list bricks;
    for (const std::uint32_t brick : divergence.bricks) {
      const Index3 at = replica.bone().place(brick);
      bricks.append(py::make_tuple(at[0], at[1], at[2]));
    }
    py::dict one;
    one["tick"] = divergence.tick;
    one["what"] = divergence.what;
    one["compared_at"] = divergence.compared_at;
    one["exact"] = divergence.exact;
    one["bricks"] = bricks;
    divergences.append(one);
  }
  py::dict out;
  out["tick"] = s.tick;
  out["connected"] = s.connected;
  out["connections"] = s.connections;
  out["by_ticks"] = s.by_ticks;
  out["by_bricks"] = s.by_bricks;
  out["digests_equal"] = s.digests_equal;
  out["digests_different"] = s.digests_different;
  out["differing_ticks"] = s.differing_ticks;
  out["faults"] = s.faults;
  out["last_faults"] = faults;
  out["most_missed"] = s.most_missed;
  out["divergences"] = divergences;
  out["ended"] = s.ended;
  out["failed"] = s.failed;
  out["reason"] = text_of(s.reason);
  out["messages"] = s.received.messages;
  out["dropped"] = to_dict(s.received);
  return out;
}

void bind_publisher(py::module_& m) {
  const PublisherSettings defaults;
  py::class_<BoundPublisher>(m, "Publisher",
                             R"(Sends a follower's ticks to standard OpenIGTLink peers and to replicas.

Nobody waits for a peer: neither the loop nor the follower. There is no authentication: whoever reaches the
port may read.

Parameters
----------
follower : Follower
    Not yet started.
host : str
    Address to listen on; only this machine reaches the loopback address.
port : int
    0 is any free one.
hello : str
    What replicas are told of the session: JSON.
header_version : {1, 2}
    Of OpenIGTLink.
log : float
    Ticks kept for replicas that come back [s].
most_peers : int
    Connections at once, 1 to 256.
most_behind : int
    A replica that far behind is cut off [bytes].
thin_after : int
    A standard peer that far behind gets the newest tick [ticks].

Raises
------
ValueError
    If nobody can listen there, or a setting is out of range.
)")
      .def(py::init([](const std::shared_ptr<Follower>& follower, const std::string& host, int port,
                       const std::string& hello, int header_version, double log, std::size_t most_peers,
                       std::size_t most_behind, std::uint64_t thin_after) {
             if (!follower) throw std::invalid_argument("follower must be a Follower, got None");
             const PublisherSettings settings{host, port,       hello,       header_version,
                                              log,  most_peers, most_behind, thin_after};
             auto publisher = std::make_shared<Publisher>(*follower, settings);
             follower->add(publisher);
             return BoundPublisher{follower, publisher};
           }),
           py::arg("follower"), py::kw_only(), py::arg("host") = defaults.host,
           py::arg("port") = defaults.port, py::arg("hello") = defaults.hello,
           py::arg("header_version") = defaults.header_version, py::arg("log") = defaults.log,
           py::arg("most_peers") = defaults.most_peers, py::arg("most_behind") = defaults.most_behind,
           py::arg("thin_after") = defaults.thin_after)
      .def_property_readonly(
          "port", [](const BoundPublisher& p) { return p.publisher->port(); }, "It listens on this one.")
      .def_property_readonly("host", [](const BoundPublisher& p) { return p.publisher->settings().host; })
      .def_property_readonly(
          "session", [](const BoundPublisher& p) { return p.publisher->session(); },
          "A random number that names the session")
      .def_property_readonly(
          "status", [](const BoundPublisher& p) { return to_dict(p.publisher->status()); },
          "tick; standard_peers and replicas connected now; counts since the start: accepted, refused "
          "(connections beyond the most), skipped (ticks that slow standard peers did not get), cut_off "
          "(slow "
          "replicas), stalled (peers that took nothing for 5 s), hellos (asked for the hello only), by_ticks "
          "and by_bricks (replicas that went on), bad_words, ignored (messages of no use), framing_lost, "
          "too_many_faults (connections closed), out_of_range (positions not sent), bytes_sent, messages, "
          "dropped {reason: messages}")
      .def(
          "finish",
          [](const BoundPublisher& p, const std::string& reason, bool failed, double linger) {
            p.publisher->finish(*p.follower, reason, failed, linger);
          },
          py::arg("reason"), py::kw_only(), py::arg("failed") = false, py::arg("linger") = 2.0,
          py::call_guard<py::gil_scoped_release>(),
          "After the follower was stopped: tells the replicas why the session ended, its last tick and "
          "digest, "
          "waits up to `linger` [s] until they have it, and stops. ValueError if `linger` is negative.")
      .def(
          "stop", [](const BoundPublisher& p) { p.publisher->stop(); },
          py::call_guard<py::gil_scoped_release>(), "Closes all connections, without a word.");
}

void bind_replica(py::module_& m) {
  py::class_<Replica, std::shared_ptr<Replica>>(m, "Replica",
                                                R"(A bone that follows a leader over the network.

`fetch_hello` first, then `start` with the bone that the hello tells of.

Parameters
----------
host : str
port : int
    Of the leader.

Raises
------
ValueError
    If `host` has no address or `port` is not 1 to 65535.
)")
      .def(py::init<const std::string&, int>(), py::arg("host"), py::arg("port"))
      .def("fetch_hello", &Replica::fetch_hello, py::arg("timeout") = 1.0,
           py::call_guard<py::gil_scoped_release>(),
           "Asks for the leader's hello for `timeout` [s]; whether it came.")
      .def_property_readonly(
          "hello", [](const Replica& r) { return text_of(r.hello().text); },
          "What the leader says of its session")
      .def_property_readonly(
          "initial_digest", [](const Replica& r) { return r.hello().digest; },
          "Of the leader's initial volume")
      .def_property_readonly(
          "first_tick", [](const Replica& r) { return r.hello().first_tick; },
          "Ticks executed on the initial volume")
      .def_property_readonly(
          "session", [](const Replica& r) { return r.hello().session; }, "0 before the hello came")
      .def(
          "start",
          [](Replica& replica, std::shared_ptr<VoxelBone> bone, const Tools& tools, std::uint64_t seed,
             double period, const std::string& scheme, std::shared_ptr<AnatomyWatch> watch) {
            SessionSetup setup;
            for (const auto& [burr, material] : tools) setup.tools.push_back({burr, material});
            setup.seed = seed;
            setup.period = period;
            setup.scheme = parse_scheme(scheme);
            const py::gil_scoped_release release;
            replica.start(std::move(bone), setup, std::move(watch));
          },
          py::arg("bone"), py::arg("tools"), py::arg("seed"), py::kw_only(), py::arg("period") = 1.0,
          py::arg("scheme") = "layer", py::arg("watch") = nullptr,
          R"(Follows from now on, in a thread of its own.

Parameters
----------
bone : VoxelBone
    Changed in place.
tools, seed, period, scheme
    As for `TickExecutor`.
watch : AnatomyWatch, optional
    Of this bone.

Raises
------
ValueError
    If it was started before, the hello was not fetched, or the bone is not the leader's initial volume.
)")
      .def(
          "stop", [](Replica& r) { r.stop(); }, py::call_guard<py::gil_scoped_release>())
      .def("wait", &Replica::wait, py::arg("seconds"), py::call_guard<py::gil_scoped_release>(),
           "Until the session ends; whether it has.")
      .def_property_readonly(
          "status",
          [](const Replica& replica) {
            ReplicaStatus status;
            {
              const py::gil_scoped_release release;
              status = replica.status();
            }
            return to_dict(status, replica);
          },
          "tick (executed), connected, connections, by_ticks and by_bricks (how it went on), digests_equal, "
          "digests_different, differing_ticks, faults (connections given up), last_faults [(tick, tick seen, "
          "reason)], most_missed (ticks until a loss was noticed), divergences [{tick, what, compared_at, "
          "exact, bricks (z, y, x)}], ended, failed, reason, messages, dropped {reason: messages}")
      .def("digest", &Replica::digest, py::call_guard<py::gil_scoped_release>(), "Of the bone now.")
      .def("snapshot", &snapshot_of<Replica>, "(copy of the bone, ticks it has seen)")
      .def(
          "take",
          [](Replica& replica) {
            BoneUpdate update;
            {
              const py::gil_scoped_release release;
              update = replica.take_changed();
            }
            return ::to_dict(update, replica.bone());
          },
          "What changed since the last call: tick (executed), newest (its record, or None), bricks (n, 3) "
          "(z, y, x) of 8^3 voxels, density (n, 8, 8, 8).")
      .def("watched", &watched_by<Replica>, py::arg("known") = 0,
           "What the watch has seen, as `AnatomyWatch.seen`. ValueError if there is none.")
      .def("flip", &Replica::flip, py::arg("voxel"), py::call_guard<py::gil_scoped_release>(),
           "Changes one voxel (z, y, x), so that tests see it found and repaired.");
}

}  // namespace

void bind_network(py::module_& m) {
  bind_publisher(m);
  bind_replica(m);
}
