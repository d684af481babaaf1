#include "bindings.hpp"
#include "network/force_watchdog.hpp"
#include "network/publisher.hpp"
#include "network/replica.hpp"

namespace {

py::dict to_dict(const openigtlink::Counters& counters) {
  py::dict dropped;
  for (std::size_t i = 0; i < counters.dropped.size(); ++i)
    if (counters.dropped[i]) dropped[openigtlink::drop_name(openigtlink::Drop(i))] = counters.dropped[i];
  return dropped;
}

py::dict to_dict(const PublisherStatus& s) {
  return py::dict("tick"_a = s.tick, "standard_peers"_a = s.standard_peers, "replicas"_a = s.replicas,
                  "accepted"_a = s.accepted, "refused"_a = s.refused, "skipped"_a = s.skipped,
                  "cut_off"_a = s.cut_off, "stalled"_a = s.stalled, "hellos"_a = s.hellos,
                  "by_ticks"_a = s.by_ticks, "by_bricks"_a = s.by_bricks, "bad_words"_a = s.bad_words,
                  "ignored"_a = s.ignored, "framing_lost"_a = s.framing_lost,
                  "too_many_faults"_a = s.too_many_faults, "out_of_range"_a = s.out_of_range,
                  "bytes_sent"_a = s.bytes_sent, "vrpn_peers"_a = s.vrpn_peers, "vrpn_calls"_a = s.vrpn_calls,
                  "datagrams"_a = s.datagrams, "messages"_a = s.received.messages,
                  "dropped"_a = to_dict(s.received), "vrpn_others"_a = s.vrpn_others);
}

py::dict to_dict(const ReplicaStatus& s, const Replica& replica) {
  py::list faults, divergences;
  for (const ReplicaFault& fault : s.last_faults)
    faults.append(py::make_tuple(fault.tick, fault.seen, fault.reason));
  for (const Divergence& divergence : s.divergences) {
    py::list bricks;
    for (const std::uint32_t brick : divergence.bricks) bricks.append(three(replica.bone().place(brick)));
    divergences.append(py::dict("tick"_a = divergence.tick, "what"_a = divergence.what,
                                "compared_at"_a = divergence.compared_at, "exact"_a = divergence.exact,
                                "bricks"_a = bricks));
  }
  return py::dict("tick"_a = s.tick, "connected"_a = s.connected, "connections"_a = s.connections,
                  "by_ticks"_a = s.by_ticks, "by_bricks"_a = s.by_bricks, "digests_equal"_a = s.digests_equal,
                  "digests_different"_a = s.digests_different, "differing_ticks"_a = s.differing_ticks,
                  "faults"_a = s.faults, "last_faults"_a = faults, "most_missed"_a = s.most_missed,
                  "divergences"_a = divergences, "ended"_a = s.ended, "failed"_a = s.failed,
                  "reason"_a = to_text(s.reason), "messages"_a = s.received.messages,
                  "dropped"_a = to_dict(s.received));
}

void bind_publisher(py::module_& m) {
  const PublisherSettings defaults;
  Class<Publisher, std::shared_ptr<Publisher>>(
      m, "Publisher",
      "Sends the ticks of a follower that is not started yet to standard OpenIGTLink peers, to replicas and "
      "to VRPN clients, as publisher.hpp says; nobody waits. ValueError if the address or a setting cannot "
      "be used.")
      .def(py::init([](const std::shared_ptr<Follower>& follower, const std::string& host,
                       std::optional<int> port, const std::string& hello, int header_version, bool sensor,
                       double log, std::size_t most_peers, std::size_t most_behind, std::uint64_t thin_after,
                       std::optional<int> vrpn) {
             if (!follower) throw std::invalid_argument("follower must be a Follower, got None");
             if (std::min(port.value_or(0), vrpn.value_or(0)) < 0) refuse("port", "0 to 65535, or None", -1);
             const PublisherSettings settings{
                 host, port.value_or(-1), hello,       header_version, sensor,
                 log,  most_peers,        most_behind, thin_after,     vrpn.value_or(-1)};
             auto publisher = std::make_shared<Publisher>(*follower, settings);
             follower->add(publisher);
             return publisher;
           }),
           "follower"_a, py::keep_alive<1, 2>(), py::kw_only(), "host"_a = defaults.host,
           "port"_a = defaults.port, "hello"_a = defaults.hello, "header_version"_a = defaults.header_version,
           "sensor"_a = defaults.sensor, "log"_a = defaults.log, "most_peers"_a = defaults.most_peers,
           "most_behind"_a = defaults.most_behind, "thin_after"_a = defaults.thin_after,
           "vrpn"_a = py::none())
      .def_readonly("port", &Publisher::port, "It listens here; 0: nowhere.")
      .def_readonly("vrpn_port", &Publisher::vrpn_port, "It listens to VRPN's clients here; 0: nowhere.")
      .def_readonly("session", &Publisher::session, "Random number that names the session")
      .def_readonly(
          "status", [](const Publisher& p) { return to_dict(p.status()); },
          "A dict: tick; standard_peers and replicas connected; counts since the start: accepted, refused "
          "(connections beyond `most_peers`), skipped (ticks that slow standard peers missed), cut_off (slow "
          "replicas), stalled (peers that took nothing, or VRPN clients that did not greet, for 5 s), hellos "
          "(asked only for the hello), by_ticks "
          "and by_bricks (replicas that continued), bad_words, ignored (messages without use), framing_lost, "
          "too_many_faults (connections closed), out_of_range (positions not sent), bytes_sent, messages, "
          "vrpn_peers (connected), vrpn_calls (clients called back), datagrams (sent over UDP), dropped "
          "{reason: messages}, vrpn_others (VRPN clients of another minor version)")
      .def(
          "finish", &Publisher::finish, "reason"_a, py::kw_only(), "failed"_a = false, "linger"_a = 2.0,
          no_gil,
          "To be called after the follower was stopped. Tells the replicas the reason, the last tick and its "
          "digest, waits at most `linger` [s] until they have it, and stops. ValueError if `linger` is "
          "negative.")
      .def("stop", &Publisher::stop, no_gil, "Closes all connections without telling the peers.");
}

void bind_replica(py::module_& m) {
  Class<Replica, std::shared_ptr<Replica>>(
      m, "Replica",
      "A bone that follows a leader over the network: `fetch_hello`, then `start` with the bone that the "
      "hello describes. ValueError if `host` has no address or `port` is not 1 to 65535.")
      .def(py::init<const std::string&, int>(), "host"_a, "port"_a)
      .def("fetch_hello", &Replica::fetch_hello, "timeout"_a = 1.0, no_gil,
           "Asks for the leader's hello for `timeout` [s]; returns whether it came.")
      .def_readonly("hello", [](const Replica& r) { return to_text(r.hello().text); })
      .def_readonly("initial_digest", [](const Replica& r) { return r.hello().digest; })
      .def_readonly("first_tick", [](const Replica& r) { return r.hello().first_tick; })
      .def_readonly("session", [](const Replica& r) { return r.hello().session; })
      .def(
          "start",
          [](Replica& replica, std::shared_ptr<VoxelBone> bone, const Tools& tools, std::uint64_t seed,
             double period, const std::string& scheme, std::shared_ptr<AnatomyWatch> watch) {
            const SessionSetup setup = to_setup(tools, seed, period, scheme);
            const py::gil_scoped_release release;
            replica.start(std::move(bone), setup, std::move(watch));
          },
          "bone"_a, "tools"_a, "seed"_a, py::kw_only(), "period"_a = 1.0, "scheme"_a = "layer",
          "watch"_a = nullptr,
          "Starts to follow, in its own thread; changes the bone in place. `tools`, `seed`, `period` and "
          "`scheme` are as for `TickExecutor`. ValueError if it was started before, the hello was not "
          "fetched, or the bone is not the leader's initial volume.")
      .def(
          "stop", [](Replica& r) { r.stop(); }, no_gil)
      .def("wait", &Replica::wait, "seconds"_a, no_gil,
           "Waits for the session's end; returns whether it came.")
      .def_readonly(
          "status",
          [](const Replica& replica) {
            return to_dict(without_gil([&] { return replica.status(); }), replica);
          },
          "A dict: tick (executed), connected, connections, by_ticks and by_bricks (how it continued), "
          "digests_equal, digests_different, differing_ticks, faults (connections given up), last_faults "
          "[(tick, tick seen, reason)], most_missed (ticks until a loss was noticed), divergences [{tick, "
          "what, compared_at, exact, bricks (z, y, x)}], ended, failed, reason, messages, dropped {reason: "
          "messages}")
      .def("digest", &Replica::digest, no_gil, "Of the present bone.")
      .def("snapshot", &snapshot_of<Replica>, "(copy of the bone, ticks executed on it)")
      .def(
          "take",
          [](Replica& replica) {
            return ::to_dict(without_gil([&] { return replica.take_changed(); }), replica.bone());
          },
          "Changes since the last call, as `Follower.take`.")
      .def("watched", &watched_by<Replica>, "known"_a = 0,
           "As `AnatomyWatch.seen`. ValueError without a watch.");
}

void bind_force_watchdog(py::module_& m) {
  Class<ForceWatchdog>(m, "ForceWatchdog",
                       "Sends `rest`, a whole message with force zero, over a connected socket, a "
                       "descriptor that it duplicates, once no `beat` came for `silence` [ms], also "
                       "while other code holds the interpreter. ValueError if that is not positive or "
                       "the socket is none.")
      .def(py::init<int, std::string, double>(), "socket"_a, "rest"_a, "silence"_a)
      .def("send", &ForceWatchdog::send, "message"_a, no_gil,
           "Sends a whole message; False if the connection ended, or took nothing for a second.")
      .def("beat", &ForceWatchdog::beat,
           "The program lives. Returns whether `rest` was sent since the last call.");
}

}  // namespace

void bind_network(py::module_& m) {
  bind_force_watchdog(m);
  bind_publisher(m);
  bind_replica(m);
}
