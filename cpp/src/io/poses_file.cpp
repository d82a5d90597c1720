// poses.json.
#include <cmath>

#include "document.hpp"

namespace plenocal {
namespace {

constexpr int kVersion = 1;

}  // namespace

std::map<int, Pose> read_poses(const std::string& path) {
  const Json json = document(path, "plenocal-poses", kVersion);
  const Field list = Field(json, path, "")["poses"];
  std::map<int, Pose> poses;
  for (std::size_t i = 0; i < list.size(); ++i) {
    const Field entry = list.at(i), transform = entry["camera_from_board"];
    const int frame = entry["frame"].integer();
    const Pose pose{transform["rotation_vector_rad"].vector(),
                    transform["translation_mm"].vector()};
    if (!poses.emplace(frame, pose).second) {
      fail(path, "frame " + std::to_string(frame) + " has two poses");
    }
  }
  return poses;
}

void write_poses(const std::string& path, const std::map<int, Pose>& poses) {
  Json list = Json::array();
  for (const auto& [frame, pose] : poses) {
    const auto &r = pose.rotation, &t = pose.translation;
    for (double value : pose_block(pose)) {
      if (!std::isfinite(value)) {
        throw std::invalid_argument("the pose of frame " + std::to_string(frame) +
                                    " is not finite");
      }
    }
    list.push_back(
        {{"frame", frame},
         {"camera_from_board",
          {{"rotation_vector_rad", {r.x, r.y, r.z}}, {"translation_mm", {t.x, t.y, t.z}}}}});
  }
  const Json json = {{"format", "plenocal-poses"}, {"version", kVersion}, {"poses", list}};
  write_text(path, json.dump(2) + "\n");
}

}  // namespace plenocal
