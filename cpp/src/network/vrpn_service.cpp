#include "vrpn_service.hpp"

#include <cstring>

#include "network/vrpn.hpp"
#include "session/realtime.hpp"

namespace burrlab {

using openigtlink::ByteView;

constexpr std::size_t most_requests = 16;  // read in a second, and calls back not yet taken
constexpr std::size_t udp_size = vrpn::pose_size + vrpn::velocity_size;  // of a burr and tick [bytes]

class VrpnService::VrpnPeer : public Peer {
 public:
  VrpnPeer(int connection, VrpnService& service)
      : Peer(connection), service_(service), reader_(service.senders_, 4096) {
    vrpn::encode_cookie(pending);
  }
  ~VrpnPeer() override { service_.peers_ -= counted_; }

  const openigtlink::StreamCutter& cutter() const override { return reader_; }
  bool feed(ByteView bytes) override {
    return reader_.feed(bytes, [this](const vrpn::Message& message) { take(message); });
  }
  void refill() override;
  bool greeted() const override { return reader_.greeted(); }

  PeerAddress address;

 private:
  void take(const vrpn::Message& message);

  VrpnService& service_;
  vrpn::Reader reader_;
  bool counted_ = false;    // among the service's peers
  std::uint64_t tick_ = 0;  // the next
  PeerAddress poses_;       // where it awaits UDP packets
  std::uint32_t next_on_tcp_ = 0, next_on_udp_ = 0;
};

void VrpnService::VrpnPeer::take(const vrpn::Message& message) {
  PublisherStatus& status = service_.session_.status;
  if (message.kind == vrpn::Kind::cookie && reader_.greeted()) {
    status.vrpn_others += std::uint64_t(message.number);
    counted_ = true;
    ++service_.peers_;
    vrpn::encode_descriptions(pending, service_.senders_);
    tick_ = service_.log_.next();
  } else if (message.kind == vrpn::Kind::ping) {
    vrpn::encode_pong(pending, std::int32_t(message.sender), openigtlink::timestamp_now());
  } else if (message.kind == vrpn::Kind::udp &&  // never at our port: the server would be its own client
             !(message.number == service_.server_.port() && TcpServer::is_own(address))) {
    poses_ = address.with_port(message.number);
  } else if (message.kind != vrpn::Kind::sender) {
    ++status.ignored;
  }
}

void VrpnService::VrpnPeer::refill() {
  if (!greeted()) return;
  const TickLog& log = service_.log_;
  const std::size_t over_udp = poses_.size ? udp_size * service_.session_.burrs : 0;
  for (const std::uint64_t until = ticks_to_send(service_.session_, log, tick_); tick_ < until; ++tick_) {
    std::uint64_t begin = 0, end = 0;
    if (!log.place_of(tick_, begin) || !log.place_of(tick_ + 1, end)) continue;
    if (over_udp) {
      openigtlink::Bytes& packet = service_.bytes_;
      packet.clear();
      log.copy(begin, over_udp, packet);
      vrpn::number_messages(packet.data(), over_udp, next_on_udp_);
      service_.session_.status.datagrams += service_.datagrams_.send(poses_, packet.data(), over_udp);
    }
    const std::size_t size = pending.size();
    log.copy(begin + over_udp, std::size_t(end - begin) - over_udp, pending);
    vrpn::number_messages(pending.data() + size, pending.size() - size, next_on_tcp_);
  }
}

VrpnService::VrpnService(PublishedSession& session)
    : session_(session),
      senders_(session.burr_names()),
      server_(session.settings.host, session.settings.vrpn, standard_send_buffer),
      log_(poses_kept * (udp_size + vrpn::force_size) * session.burrs, poses_kept, session.status.tick) {}

std::unique_ptr<Peer> VrpnService::make_peer(int socket) {
  auto peer = std::make_unique<VrpnPeer>(socket, *this);
  peer->address = TcpServer::peer_of(socket);
  return peer;
}

/// Poses and velocities first: they may go over UDP. The velocity is the device's; it turned since the last
/// tick.
void VrpnService::append_newest(std::uint64_t timestamp) {
  bytes_.clear();
  const TickRecord& record = session_.newest;
  for (std::uint32_t i = 0; i < session_.burrs; ++i) {
    const BurrRecord& burr = record.burr[i];
    const Vec3 center(burr.center.data()), velocity(burr.device_velocity.data());
    Eigen::Quaterniond turn = Eigen::Quaterniond::Identity();
    if (last_orientation_[i] != Quaternion{})
      turn = to_eigen(burr.orientation) * to_eigen(last_orientation_[i]).conjugate();
    last_orientation_[i] = burr.orientation;
    vrpn::encode_pose(bytes_, std::int32_t(i), timestamp, 1e-3 * center, burr.orientation);
    vrpn::encode_velocity(bytes_, std::int32_t(i), timestamp, 1e-3 * velocity,
                          {turn.w(), turn.x(), turn.y(), turn.z()}, 1e-3 * session_.period * record.k);
  }
  for (std::uint32_t i = 0; i < session_.burrs; ++i)
    vrpn::encode_force(bytes_, std::int32_t(i), timestamp, Vec3(record.burr[i].force.data()));
  log_.append_tick({bytes_.data(), bytes_.size()});
}

void VrpnService::restart(std::uint64_t tick) {
  log_.restart(tick);
  last_orientation_ = {};
}

int VrpnService::request_socket() {
  if (steady_now() - last_second_ > second) {
    last_second_ = steady_now();
    requests_ = 0;
  }
  return requests_ < most_requests ? datagrams_.socket() : -1;
}

/// A client asks with "host port". Only the port is used: whoever asks is called at the address that asks, as
/// another one may not want it, but never at a port of ours: the server would be its own client.
void VrpnService::answer_requests(int igtl_port, std::size_t connecting,
                                  const std::function<bool(std::unique_ptr<Peer>)>& admit) {
  char text[200];
  PeerAddress client;
  while (requests_ < most_requests) {
    const long size =
        receive_from(datagrams_.socket(), reinterpret_cast<std::uint8_t*>(text), sizeof text - 1, client);
    if (size < 0) return;
    ++requests_;
    text[size] = 0;
    const char* space = std::strchr(text, ' ');
    const int port = space ? std::atoi(space + 1) : 0;
    const bool is_server = (port == igtl_port || port == server_.port()) && TcpServer::is_own(client);
    const bool callable = port >= 1024 && port <= 65535 && !is_server && connecting < most_requests;
    const int socket = callable ? TcpServer::connect(client.with_port(port), standard_send_buffer) : -1;
    if (socket < 0) {
      const std::lock_guard<std::mutex> lock(session_.mutex);
      ++session_.status.refused;
      continue;
    }
    auto peer = std::make_unique<VrpnPeer>(socket, *this);
    peer->address = client;
    peer->connecting = true;
    if (!admit(std::move(peer))) continue;
    ++connecting;
    const std::lock_guard<std::mutex> lock(session_.mutex);
    ++session_.status.vrpn_calls;
  }
}

}  // namespace burrlab
