// A standard peer made with Debian's libopenigtlink: openigtlink_peer HOST PORT. Prints a line for each
// TRANSFORM and SENSOR with a right checksum, until the server closes.
#include <igtlClientSocket.h>
#include <igtlMessageHeader.h>
#include <igtlSensorMessage.h>
#include <igtlTransformMessage.h>
#include <igtl_unit.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace {

template <class Pointer>
bool receive(igtl::ClientSocket& socket, igtl::MessageHeader::Pointer& header, const Pointer& message) {
  message->SetMessageHeader(header);
  message->AllocatePack();
  socket.Receive(message->GetPackBodyPointer(), message->GetPackBodySize());
  return (message->Unpack(1) & igtl::MessageHeader::UNPACK_BODY) != 0;
}

}  // namespace

int main(int, char** argument) {
  const igtl::ClientSocket::Pointer socket = igtl::ClientSocket::New();
  if (socket->ConnectToServer(argument[1], std::atoi(argument[2])) != 0) return 1;
  for (;;) {
    igtl::MessageHeader::Pointer header = igtl::MessageHeader::New();
    header->InitPack();
    if (socket->Receive(header->GetPackPointer(), header->GetPackSize()) != header->GetPackSize()) return 0;
    header->Unpack();
    igtl::TimeStamp::Pointer time = igtl::TimeStamp::New();
    header->GetTimeStamp(time);
    if (std::strcmp(header->GetDeviceType(), "TRANSFORM") == 0) {
      const igtl::TransformMessage::Pointer message = igtl::TransformMessage::New();
      if (!receive(*socket, header, message)) continue;
      igtl::Matrix4x4 matrix;
      message->GetMatrix(matrix);
      std::printf("TRANSFORM %s %.6f", header->GetDeviceName(), time->GetTimeStamp());
      for (int row = 0; row < 3; ++row)
        for (int column = 0; column < 4; ++column) std::printf(" %.9g", double(matrix[row][column]));
      std::printf("\n");
    } else if (std::strcmp(header->GetDeviceType(), "SENSOR") == 0) {
      const igtl::SensorMessage::Pointer message = igtl::SensorMessage::New();
      if (!receive(*socket, header, message)) continue;
      igtl_unit_data unit;
      igtl_unit_unpack(message->GetUnit(), &unit);
      std::printf("SENSOR %s %.6f %d %d^%d", header->GetDeviceName(), time->GetTimeStamp(), int(unit.prefix),
                  int(unit.unit[0]), int(unit.exp[0]));
      for (unsigned i = 0; i < message->GetLength(); ++i) std::printf(" %.17g", message->GetValue(i));
      std::printf("\n");
    } else {
      socket->Skip(header->GetBodySizeToRead(), 0);
    }
  }
}
