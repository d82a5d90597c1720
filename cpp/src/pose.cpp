#include <Eigen/Geometry>

#include "checks.hpp"
#include "plenocal/projection.hpp"

namespace plenocal {
namespace {

Eigen::Isometry3d motion(const Pose& pose) {
  for (double value : pose_block(pose)) {
    if (!std::isfinite(value)) reject("the pose is not finite");
  }
  const auto &r = pose.rotation, &t = pose.translation;
  const Eigen::Vector3d rotation(r.x, r.y, r.z);
  const double angle = rotation.norm();
  Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
  if (angle > 0.0) result.linear() = Eigen::AngleAxisd(angle, rotation / angle).toRotationMatrix();
  result.translation() = Eigen::Vector3d(t.x, t.y, t.z);
  return result;
}

Pose pose(const Eigen::Isometry3d& motion) {
  const Eigen::AngleAxisd turn(motion.linear());
  const Eigen::Vector3d r = turn.angle() * turn.axis(), t = motion.translation();
  return {{r.x(), r.y(), r.z()}, {t.x(), t.y(), t.z()}};
}

}  // namespace

Pose composed(const Pose& second, const Pose& first) {
  return pose(motion(second) * motion(first));
}

Vector3<double> transformed(const Pose& pose, const Vector3<double>& point) {
  if (!std::isfinite(point.x) || !std::isfinite(point.y) || !std::isfinite(point.z)) {
    reject("the point is not finite");
  }
  const Eigen::Vector3d p = motion(pose) * Eigen::Vector3d(point.x, point.y, point.z);
  return {p.x(), p.y(), p.z()};
}

Pose inverse(const Pose& of) { return pose(motion(of).inverse()); }

}  // namespace plenocal
