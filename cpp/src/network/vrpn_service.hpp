// A published session as a VRPN server: Trackers and ForceDevices, over TCP and UDP.
#pragma once

#include <array>
#include <functional>

#include "published_session.hpp"

namespace burrlab {

/// Used under the session's mutex, unless it says otherwise.
class VrpnService {
 public:
  explicit VrpnService(PublishedSession& session);  ///< throws if the port is taken

  std::uint64_t peers() const { return peers_; }  ///< that greeted
  void append_newest(std::uint64_t timestamp);
  void restart(std::uint64_t tick);

  // Without the mutex:
  TcpServer& server() { return server_; }
  std::unique_ptr<Peer> make_peer(int socket);
  /// Where clients ask to be called; -1 when enough were heard in this second.
  int request_socket();
  /// Calls clients that ask for it, unless `connecting` calls have not been taken yet; `admit` gets each
  /// connection begun. `igtl_port` is no client's.
  void answer_requests(int igtl_port, std::size_t connecting,
                       const std::function<bool(std::unique_ptr<Peer>)>& admit);
  void close() noexcept { server_.stop_listening(), datagrams_.close(); }

 private:
  class VrpnPeer;

  PublishedSession& session_;
  std::vector<std::string> senders_;
  TcpServer server_;
  UdpSocket datagrams_{server_};
  std::int64_t last_second_ = 0;  // the second in which `requests_` were read [ns]
  std::size_t requests_ = 0;
  std::uint64_t peers_ = 0;
  TickLog log_;
  openigtlink::Bytes bytes_;
  std::array<Quaternion, most_burrs> last_orientation_{};
};

}  // namespace burrlab
