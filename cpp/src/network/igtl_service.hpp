// Poses and forces of a published session for standard OpenIGTLink peers.
#pragma once

#include "published_session.hpp"
#include "replica_service.hpp"

namespace burrlab {

/// Used under the session's mutex, except `make_peer`.
class IgtlService {
 public:
  IgtlService(PublishedSession& session, ReplicaService& replicas);

  std::unique_ptr<Peer> make_peer(int socket);
  bool empty() const { return log_.end() == 0; }  ///< no tick was executed
  void append_newest(std::uint64_t timestamp);
  void restart(std::uint64_t tick) { log_.restart(tick); }

 private:
  class IgtlPeer;
  void append_force_text(openigtlink::Bytes& out, std::string_view name);

  PublishedSession& session_;
  ReplicaService& replicas_;
  std::vector<std::string> burr_names_;
  TickLog log_;
  openigtlink::Bytes bytes_;
};

}  // namespace burrlab
