#include "igtl_service.hpp"

#include <sstream>

#include "network/bone_frame.hpp"
#include "wire.hpp"

namespace burrlab {

using openigtlink::Message;
using replica_protocol::Kind;

constexpr std::size_t largest_pose = 380;  // messages of one burr and tick [bytes]
/// Of the forces as PLUS and 3D Slicer read them, and as SENSOR.
constexpr std::string_view force_name[] = {"Force", "Force_1"};
constexpr std::string_view sensor_name[] = {"burrlab_force_0", "burrlab_force_1"};

static Vec3 force_in_ras(const BurrRecord& burr) {
  return {0.0 - burr.force[0], 0.0 - burr.force[1], burr.force[2]};
}

/// A standard peer until it says that it is a replica.
class IgtlService::IgtlPeer : public Peer {
 public:
  IgtlPeer(int connection, IgtlService& service) : Peer(connection), service_(service) {}

  const openigtlink::StreamCutter& cutter() const override { return framer_; }
  bool feed(openigtlink::ByteView bytes) override {
    return framer_.feed(bytes, [this](const Message& message) { take(message); });
  }
  void refill() override;
  void leave() override {
    if (replica_) replica_->leave();
  }
  bool too_slow() const override { return replica_ && replica_->too_slow(); }

 private:
  void take(const Message& message);

  IgtlService& service_;
  openigtlink::MessageFramer framer_{4096};
  std::uint64_t tick_ = ~std::uint64_t(0);  // the next; at first that after the newest
  std::unique_ptr<ReplicaStream> replica_;
};

void IgtlService::IgtlPeer::take(const Message& message) {
  PublisherStatus& status = service_.session_.status;
  replica_protocol::Word word;
  if (!closing && !replica_ && message.header.type.view() == openigtlink::get_string_type) {
    service_.append_force_text(pending, message.header.device_name.view());
  } else if (closing || replica_protocol::kind_of(message) != Kind::word) {
    ++status.ignored;
  } else if (replica_) {
    if (!decode(message, word) || !replica_->take(word)) ++status.ignored;
  } else if (decode(message, word)) {
    replica_ = service_.replicas_.answer(*this, word);
    closing = !replica_;
  } else {
    ++status.bad_words;
    closing = true;
  }
}

void IgtlService::IgtlPeer::refill() {
  if (replica_) return replica_->refill();
  const std::uint64_t until = ticks_to_send(service_.session_, service_.log_, tick_);
  std::uint64_t begin = 0, end = 0;
  if (service_.log_.place_of(tick_, begin) && service_.log_.place_of(until, end))
    service_.log_.copy(begin, std::size_t(end - begin), pending);
  tick_ = until;
}

IgtlService::IgtlService(PublishedSession& session, ReplicaService& replicas)
    : session_(session),
      replicas_(replicas),
      burr_names_(session.burr_names()),
      log_(poses_kept * largest_pose * session.burrs, poses_kept, session.status.tick) {}

std::unique_ptr<Peer> IgtlService::make_peer(int socket) { return std::make_unique<IgtlPeer>(socket, *this); }

void IgtlService::append_newest(std::uint64_t timestamp) {
  bytes_.clear();
  const auto envelope = [&](std::string_view name) {
    return openigtlink::Envelope{name, timestamp, session_.settings.header_version};
  };
  for (std::uint32_t i = 0; i < session_.burrs; ++i) {
    const BurrRecord& burr = session_.newest.burr[i];
    const Vec3 center(burr.center.data());
    if (openigtlink::is_plausible(center))
      encode_transform(bytes_, envelope(burr_names_[i]), openigtlink::to_ras(center, burr.orientation));
    else
      ++session_.status.out_of_range;
    if (session_.settings.sensor)
      encode_sensor(bytes_, envelope(sensor_name[i]), force_in_ras(burr).data(), 3);
    encode_transform(bytes_, envelope(force_name[i]), openigtlink::to_ras(Vec3(burr.force.data())));
  }
  log_.append_tick({bytes_.data(), bytes_.size()});
}

/// Answers a GET_STRING: the newest force as text, if a burr has this name.
void IgtlService::append_force_text(openigtlink::Bytes& out, std::string_view name) {
  for (std::uint32_t i = 0; i < session_.burrs; ++i) {
    if (name != force_name[i] && !(name.empty() && i == 0)) continue;
    const Vec3 force = force_in_ras(session_.newest.burr[i]);
    std::ostringstream text;
    text.imbue(std::locale::classic());  // a decimal point, whatever the program's language
    text.precision(9);
    text << force[0] << ' ' << force[1] << ' ' << force[2];
    return openigtlink::encode_string(
        out, {force_name[i], openigtlink::timestamp_now(), session_.settings.header_version}, text.str());
  }
  ++session_.status.ignored;
}

}  // namespace burrlab
