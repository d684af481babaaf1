#include "network/vrpn_log.hpp"

#include <algorithm>

#include "burrlab/error.hpp"
#include "wire.hpp"

namespace burrlab::vrpn {

namespace {

constexpr std::int32_t first_type = -5, type_end = 2000;  // VRPN's own, and those with a name

using Names = std::map<std::int32_t, std::string>;

std::string name_of(const Names& names, const char* what, std::int32_t number) {
  const auto at = names.find(number);
  return at == names.end() ? std::string(what) + " " + std::to_string(number) : at->second;
}

void append(LoggedMessages& messages, const Message& message, std::int64_t time) {
  const auto add_row = [&](std::int32_t number) {
    messages.times.push_back(time);
    messages.numbers.push_back(number);
  };
  if (message.kind == Kind::buttons) {
    for (std::size_t i = 0; i < message.states.size / 4; ++i) {
      add_row(std::int32_t(i));
      messages.values.push_back(is_pressed(message.states, i));
    }
    return;
  }
  add_row(message.number);
  const auto& v = message.values;
  if (message.kind == Kind::button)
    messages.values.push_back(message.pressed);
  else if (message.kind == Kind::force)
    messages.values.insert(messages.values.end(), {v[0], v[1], v[2]});
  else
    messages.values.insert(messages.values.end(),
                           {1e3 * v[0], 1e3 * v[1], 1e3 * v[2], v[6], v[3], v[4], v[5]});
  if (message.kind == Kind::velocity) messages.values.push_back(v[7]);
}

}  // namespace

Log read_log(ByteView file) {
  Log log;
  Names senders, types;
  std::map<std::pair<std::int32_t, std::int32_t>, std::size_t> places;  // of type and sender, while named so
  ByteView payload;
  openigtlink::ByteReader reader(file);
  reader.bytes(header_size, payload);
  while (!reader.ended()) {
    const std::size_t begin = file.size - reader.left();
    std::int32_t type = 0, sender = 0;
    std::uint32_t seconds = 0, microseconds = 0, size = 0, unused = 0;
    reader.number(type).number(sender).number(seconds).number(microseconds).number(size);
    const bool whole = reader.number(unused).bytes(size, payload).ok();
    const bool names_one = type == sender_description || type == type_description;
    Message message;
    std::string_view name;
    const std::string type_name = type < 0 ? "" : name_of(types, "type", type);
    message.kind = kind_of_type(type_name);
    if (!whole || type < first_type || type >= type_end || (names_one && !decode_name(payload, name)) ||
        decode_payload(message.kind, payload, message) == Drop::bad_length)
      throw InvalidArgument("at byte " + std::to_string(begin) + " stands no whole message");
    if (names_one) {
      name.remove_suffix(name.size() - (name.find_last_not_of('\0') + 1));
      (type == type_description ? types : senders)[sender] = name;
      places.clear();
    } else if (message.kind >= Kind::ping) {
      if (type >= 0) ++log.others[type_name];
    } else {
      const auto [place, is_new] = places.try_emplace({type, sender}, log.messages.size());
      if (is_new) {
        const Kind kind = message.kind == Kind::buttons ? Kind::button : message.kind;
        const std::string sender_name = name_of(senders, "sender", sender);
        const auto at = std::find_if(log.messages.begin(), log.messages.end(), [&](const LoggedMessages& m) {
          return m.kind == kind && m.sender == sender_name;
        });
        place->second = std::size_t(at - log.messages.begin());
        if (at == log.messages.end()) log.messages.push_back({kind, sender_name, {}, {}, {}});
      }
      append(log.messages[place->second], message, std::int64_t(seconds) * 1000000 + microseconds);
    }
  }
  return log;
}

}  // namespace burrlab::vrpn
