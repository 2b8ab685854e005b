// SPDX-License-Identifier: Apache-2.0
// Photos as drones write them, as far as the angles in them go: JPEGs with XMP.
#ifndef GROUNDLOCK_TESTS_SUPPORT_PHOTO_XMP_H_
#define GROUNDLOCK_TESTS_SUPPORT_PHOTO_XMP_H_

#include <Eigen/Core>
#include <cmath>
#include <cstdio>
#include <numbers>
#include <string>

namespace groundlock::test_support {

// One APP1 segment with an XMP packet, of less than 64 KB.
inline std::string XmpSegment(const std::string& packet) {
  const std::string body =
      std::string("http://ns.adobe.com/xap/1.0/") + '\0' + packet;
  const std::size_t length = body.size() + 2;
  return std::string("\xFF\xE1") + static_cast<char>(length >> 8U) +
         static_cast<char>(length & 0xFFU) + body;
}

// Right behind the beginning of a JPEG, where cameras put it.
inline std::string WithSegment(const std::string& jpeg,
                               const std::string& segment) {
  return jpeg.substr(0, 2) + segment + jpeg.substr(2);
}

// A JPEG without a picture.
inline std::string EmptyJpeg() { return "\xFF\xD8\xFF\xD9"; }

// A packet whose description has these attributes.
inline std::string XmpPacketWith(const std::string& attributes) {
  return "<?xpacket begin=\"\xEF\xBB\xBF\" id=\"W5M0MpCehiHzreSzNTczkc9d\"?>\n"
         "<x:xmpmeta xmlns:x=\"adobe:ns:meta/\">\n"
         " <rdf:RDF "
         "xmlns:rdf=\"http://www.w3.org/1999/02/22-rdf-syntax-ns#\">\n"
         "  <rdf:Description rdf:about=\"DJI Meta Data\"\n"
         "    xmlns:drone-dji=\"http://www.dji.com/drone-dji/1.0/\"\n" +
         attributes +
         ">\n  </rdf:Description>\n </rdf:RDF>\n</x:xmpmeta>\n"
         "<?xpacket end=\"w\"?>";
}

// As DJI writes it.
inline std::string DjiPacket(double pitch_deg, double roll_deg) {
  char attributes[256];
  std::snprintf(attributes,
                sizeof(attributes),
                "    drone-dji:AbsoluteAltitude=\"+123.45\"\n"
                "    drone-dji:GimbalRollDegree=\"%+.2f\"\n"
                "    drone-dji:GimbalYawDegree=\"-17.30\"\n"
                "    drone-dji:GimbalPitchDegree=\"%+.2f\"\n"
                "    drone-dji:FlightRollDegree=\"+3.10\"\n"
                "    drone-dji:FlightPitchDegree=\"-8.40\"",
                roll_deg,
                pitch_deg);
  return XmpPacketWith(attributes);
}

// Of a camera in whose frame up is there; unit.
inline std::string DjiPacket(const Eigen::Vector3d& up_camera) {
  constexpr double kDegPerRad = 180.0 / std::numbers::pi;
  return DjiPacket(kDegPerRad * std::asin(up_camera.z()),
                   kDegPerRad * std::atan2(-up_camera.x(), -up_camera.y()));
}

}  // namespace groundlock::test_support

#endif  // GROUNDLOCK_TESTS_SUPPORT_PHOTO_XMP_H_
