// Refines a plenoptic camera with plain Ceres: one auto-diff residual block per observation,
// DENSE_SCHUR, default trust region, no tricks. It reads a problem that `plenocal calibrate
// --export-problem DIR` has written, and writes camera.json and poses.json for `plenocal compare`.
// It is an independent oracle for the library's answers and the baseline of its benchmarks, and
// therefore uses none of its headers. Equations are those of "Blur Aware Calibration of Multi-Focus
// Plenoptic Camera" (CVPR 2020), with an exit pupil and a curved field (docs/model.md).
//
// Long because it is self-contained: one file that anybody can compile and compare with.
//
// Lengths are in mm, angles in rad, image quantities in px; pixel (0, 0) is the centre of the
// top-left pixel. Camera frame: origin O at the main-lens centre, z towards the scene, x right,
// y down. The optical axis is its z axis, turned by Ry(omega_y) Rx(omega_x). The image is stored
// upright, so the pixel axes run against the camera axes:
//     u = u0 - x/s,  v = v0 - y/s   for the point (x, y) of the sensor plane z = -(D + d).
//
//   g++ -O3 -std=c++17 plain_ceres.cpp -I/usr/include/eigen3 -lceres -lglog -o plain_ceres

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <glog/logging.h>

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

using Json = nlohmann::json;

constexpr const char* kHelp =
    R"(plain_ceres: refine a plenoptic camera with plain Ceres

Usage: plain_ceres PROBLEM --out DIR [--threads N] [--verbose]

PROBLEM is a folder that `plenocal calibrate ... --export-problem PROBLEM` has written. The result
goes to camera.json and poses.json in the folder DIR, which is made if it is not there; a summary
goes to standard output as JSON.

  --threads N   threads of the solver (1)
  --verbose     iterations and Ceres' report, on standard error

Then compare: plenocal compare results/camera.json DIR/camera.json
The array has to be hexagonal with straight rows, and the board known (--board flat).
)";

// ---- Camera model --------------------------------------------------------------------------

// Parameter blocks. A pose is the angle-axis rotation and the translation of camera from board.
enum MainLens { kF, kQ1, kQ2, kQ3, kQ1m, kP1, kP2, kKappa, kKappaM, kMainLensSize };
enum Axis { kOmegaX, kOmegaY, kAxisSize };
enum ExitPupil { kEx, kEy, kEz, kEr, kPupilSize };
enum Sensor { kU0, kV0, kLittleD, kSensorSize };
enum Mla { kThetaX, kThetaY, kThetaZ, kTx, kTy, kBigD, kMlaSize };
enum Pitch { kPitch, kRatio, kPitchSize };
constexpr int kPoseSize = 6;

struct Parameters {
  std::array<double, kMainLensSize> lens{};
  std::array<double, kAxisSize> axis{};
  std::array<double, kPupilSize> pupil{};
  std::array<double, kSensorSize> sensor{};
  std::array<double, kMlaSize> mla{};
  std::array<double, kPitchSize> pitch{};
  std::vector<double> f;
  std::map<int, std::array<double, kPoseSize>> poses;

  // Parameters by the names that plenocal has for them.
  struct Place {
    double* block;
    int size, index;
  };
  std::map<std::string, Place> Names() {
    std::map<std::string, Place> names;
    const auto add = [&names](auto& block, std::initializer_list<const char*> of_block) {
      int index = 0;
      for (const char* name : of_block)
        names[name] = {block.data(), static_cast<int>(block.size()), index++};
    };
    add(lens, {"F", "Q1", "Q2", "Q3", "Q1_m", "P1", "P2", "kappa", "kappa_m"});
    add(axis, {"omega_x", "omega_y"});
    add(pupil, {"e_x", "e_y", "e_z", "e_r"});
    add(sensor, {"u0", "v0", "d"});
    add(mla, {"theta_x", "theta_y", "theta_z", "t_x", "t_y", "D"});
    add(pitch, {"dC", "dC_ratio"});
    for (size_t i = 0; i < f.size(); ++i) names["f_" + std::to_string(i + 1)] = {&f[i], 1, 0};
    return names;
  }
};

// Hexagonal, row-aligned lattice in units of the pitch; every other row is shifted by one half.
struct Lattice {
  int columns = 0, rows = 0;
  int shifted_parity = 0;  // of the shifted rows' l

  // g(k, l) - g_c, with g_c the middle of the bounding box of all nodes.
  Eigen::Vector2d Node(int k, int l) const {
    const Eigen::Vector2d g(k + (l % 2 == shifted_parity ? 0.5 : 0.0), std::sqrt(0.75) * l);
    return g - Eigen::Vector2d(0.5 * (columns - 0.5), 0.5 * std::sqrt(0.75) * (rows - 1));
  }
  // The lattice's three-colouring, in which no two neighbours have the same type.
  int Type(int k, int l, int types) const {
    return types < 3 ? 0 : ((shifted_parity == 0 ? 1 : 2) * (l % 2) + k) % 3;
  }
};

// Micro-lens centre C = Rz Ry Rx node + (tx, ty, -D), where node = -dC (g - g_c): the minus sign
// because k grows with u and u runs against x.
template <typename T>
void MicroLensCenter(const Eigen::Vector2d& g, const T* mla, const T* pitch, T C[3]) {
  using std::cos;
  using std::sin;
  const T x = -pitch[kPitch] * g.x(), y = -pitch[kPitch] * pitch[kRatio] * g.y();
  const T cx = cos(mla[kThetaX]), sx = sin(mla[kThetaX]);
  const T cy = cos(mla[kThetaY]), sy = sin(mla[kThetaY]);
  const T cz = cos(mla[kThetaZ]), sz = sin(mla[kThetaZ]);
  const T x1 = cy * x + sy * sx * y, y1 = cx * y;  // Ry Rx (x, y, 0)
  C[0] = cz * x1 - sz * y1 + mla[kTx];
  C[1] = sz * x1 + cz * y1 + mla[kTy];
  C[2] = -sy * x + cy * sx * y - mla[kBigD];
}

// Rotation from the frame of the main lens, whose z axis is the optical axis, to the camera frame.
template <typename T>
Eigen::Matrix<T, 3, 3> CameraFromLens(const T* axis) {
  using std::cos;
  using std::sin;
  const T cx = cos(axis[kOmegaX]), sx = sin(axis[kOmegaX]);
  const T cy = cos(axis[kOmegaY]), sy = sin(axis[kOmegaY]);
  Eigen::Matrix<T, 3, 3> R;
  R << cy, sy * sx, sy * cx, T(0.0), cx, -sx, -sy, cy * sx, cy * cx;  // Ry Rx
  return R;
}

// Micro-image centre: where the ray from the middle of the exit pupil through C meets the sensor.
struct CenterResidual {
  Eigen::Vector2d g;
  double u, v, std_dev, pixel_size;

  template <typename T>
  bool operator()(const T* axis, const T* pupil, const T* sensor, const T* mla, const T* pitch,
                  T* residual) const {
    T C[3];
    MicroLensCenter(g, mla, pitch, C);
    const Eigen::Matrix<T, 3, 3> R = CameraFromLens(axis);
    const Eigen::Matrix<T, 3, 1> c = R.transpose() * Eigen::Matrix<T, 3, 1>(C[0], C[1], C[2]);
    const T x_e = c[0] - pupil[kEx], y_e = c[1] - pupil[kEy];
    const T ez = pupil[kEz] + pupil[kEr] * (x_e * x_e + y_e * y_e);  // the pupil is aberrated
    const Eigen::Matrix<T, 3, 1> P = R * Eigen::Matrix<T, 3, 1>(pupil[kEx], pupil[kEy], ez);
    const T scale = (mla[kBigD] + sensor[kLittleD] + P[2]) / (P[2] - C[2]);
    const T x = P[0] + scale * (C[0] - P[0]), y = P[1] + scale * (C[1] - P[1]);
    residual[0] = (sensor[kU0] - x / pixel_size - u) / std_dev;
    residual[1] = (sensor[kV0] - y / pixel_size - v) / std_dev;
    return true;
  }
};

// BAP feature: board corner through main lens and micro-lens, and (if it counts) the radius of its
// blur, rho.
template <bool kRho>
struct FeatureResidual {
  static constexpr int kSize = kRho ? 3 : 2;
  Eigen::Vector2d g;
  Eigen::Vector3d board_point;
  double u, v, rho;
  std::array<double, 3> std_dev;
  double pixel_size;

  template <typename T>
  bool operator()(const T* lens, const T* axis, const T* sensor, const T* mla, const T* pitch,
                  const T* f, const T* pose, T* residual) const {
    using std::sqrt;
    const T p_w[3] = {T(board_point.x()), T(board_point.y()), T(board_point.z())};
    T p_c[3];
    ceres::AngleAxisRotatePoint(pose, p_w, p_c);  // p_c = R p_w + t
    for (int i = 0; i < 3; ++i) p_c[i] += pose[3 + i];
    const Eigen::Matrix<T, 3, 3> R = CameraFromLens(axis);
    const Eigen::Matrix<T, 3, 1> p = R.transpose() * Eigen::Matrix<T, 3, 1>(p_c[0], p_c[1], p_c[2]);

    const T m = -lens[kF] / (p[2] - lens[kF]);  // thin lens: p' = -F/(z_c - F) p_c
    const T x = m * p[0], y = m * p[1];
    const T r2 = x * x + y * y;
    const T z = m * p[2] + (lens[kKappa] - lens[kKappaM] * m) * r2;  // the field is curved

    // Brown-Conrady distortion of (x', y') in mm.
    const T *Q = lens + kQ1, *P = lens + kP1;
    const T radial = r2 * (Q[0] - lens[kQ1m] * m + r2 * (Q[1] + r2 * Q[2]));
    const T xd = x + x * radial + P[0] * (r2 + 2.0 * x * x) + 2.0 * P[1] * x * y;
    const T yd = y + y * radial + P[1] * (r2 + 2.0 * y * y) + 2.0 * P[0] * x * y;
    const Eigen::Matrix<T, 3, 1> image = R * Eigen::Matrix<T, 3, 1>(xd, yd, z);

    // Where the ray from C through p' meets the sensor plane z = -(D + d).
    T C[3];
    MicroLensCenter(g, mla, pitch, C);
    const T a = image[2] - C[2];                           // micro-lens to p'
    const T delta = C[2] + mla[kBigD] + sensor[kLittleD];  // micro-lens to sensor
    residual[0] =
        (sensor[kU0] - (C[0] - delta / a * (image[0] - C[0])) / pixel_size - u) / std_dev[0];
    residual[1] =
        (sensor[kV0] - (C[1] - delta / a * (image[1] - C[1])) / pixel_size - v) / std_dev[1];
    if constexpr (kRho) {
      // Blur radius: rho = dC/(2s) delta (1/f_i - 1/a - 1/delta).
      const T dC = pitch[kPitch] * sqrt(pitch[kRatio]);
      const T blur = dC / (2.0 * pixel_size) * delta * (1.0 / f[0] - 1.0 / a - 1.0 / delta);
      residual[2] = (blur - rho) / std_dev[2];
    }
    return true;
  }
};

// What is known beforehand, (quantity - value)/sigma: a parameter by its place in a block; |m|, the
// radius of micro-images by 1/N; q'_i, the blur that white images show of a lens type; the tilt
// gradient of the array as the gradient of ln d along an image axis.
struct Known {
  double value, weight;
  template <typename T>
  T Residual(const T& quantity) const {
    return (quantity - value) * weight;
  }
};
struct ParameterPrior : Known {
  int index;
  template <typename T>
  bool operator()(const T* const* blocks, T* residual) const {
    residual[0] = Residual(blocks[0][index]);
    return true;
  }
};
struct SlopePrior : Known {
  template <typename T>
  bool operator()(const T* lens, const T* pupil, const T* sensor, const T* mla, T* residual) const {
    const T p = 1.0 + pupil[kEz] / lens[kF];
    residual[0] = Residual(sensor[kLittleD] * p * lens[kF] / (2.0 * (mla[kBigD] + pupil[kEz])));
    return true;
  }
};
struct InterceptPrior : Known {
  template <typename T>
  bool operator()(const T* sensor, const T* pitch, const T* f, T* residual) const {
    using std::sqrt;
    residual[0] = Residual(pitch[kPitch] * sqrt(pitch[kRatio]) * sensor[kLittleD] / (2.0 * f[0]));
    return true;
  }
};
struct TiltGradientPrior : Known {
  int axis;
  template <typename T>
  bool operator()(const T* pupil, const T* sensor, const T* mla, T* residual) const {
    using std::cos;
    using std::sin;
    const T cx = cos(mla[kThetaX]), sx = sin(mla[kThetaX]), cy = cos(mla[kThetaY]);
    const T cz = cos(mla[kThetaZ]), sz = sin(mla[kThetaZ]), sy = sin(mla[kThetaY]);
    // The normal of the array, Rz Ry Rx e_z, over its z.
    const T normal = axis == 0 ? cz * sy * cx + sz * sx : sz * sy * cx - cz * sx;
    const T to_pupil = mla[kBigD] + pupil[kEz], d = sensor[kLittleD];
    residual[0] = Residual(to_pupil / (to_pupil + d) / d * normal / (cy * cx));
    return true;
  }
};

// ---- Input ---------------------------------------------------------------------------------

Json ReadJson(const std::string& path) {
  std::ifstream file(path);
  if (!file) throw std::runtime_error(path + ": cannot be read");
  try {
    return Json::parse(file);
  } catch (const Json::exception& error) {
    throw std::runtime_error(path + ": " + error.what());
  }
}

// The rows of a CSV file: numbers by the names of their columns.
std::vector<std::map<std::string, double>> ReadCsv(const std::string& path) {
  std::ifstream file(path);
  std::string line, cell;
  if (!std::getline(file, line)) throw std::runtime_error(path + ": cannot be read");
  std::vector<std::string> names;
  for (std::stringstream header(line); std::getline(header, cell, ',');) names.push_back(cell);
  std::vector<std::map<std::string, double>> rows;
  for (int number = 2; std::getline(file, line); ++number) {
    std::map<std::string, double>& row = rows.emplace_back();
    size_t column = 0;
    for (std::stringstream cells(line); std::getline(cells, cell, ','); ++column) {
      char* end = nullptr;
      const double value = std::strtod(cell.c_str(), &end);
      if (cell.empty()) continue;
      if (column >= names.size() || *end != '\0')
        throw std::runtime_error(path + ": line " + std::to_string(number) + " is not numbers");
      row[names[column]] = value;
    }
  }
  return rows;
}

void ReadStart(const Json& camera, const Json& poses, Lattice* lattice, Parameters* p) {
  const Json &lens = camera.at("main_lens"), &array = camera.at("micro_lens_array");
  if (array.at("lattice") != "hexagonal-rows")
    throw std::runtime_error("camera.json: the array has to be hexagonal with straight rows");
  *lattice = {array.at("columns"), array.at("rows"), array.at("shifted") == "even" ? 0 : 1};
  p->lens = {lens.at("focal_length_mm"),
             lens.at("q1_per_mm2"),
             lens.at("q2_per_mm4"),
             lens.at("q3_per_mm6"),
             lens.value("q1_growth_per_mm2", 0.0),
             lens.at("p1_per_mm"),
             lens.at("p2_per_mm"),
             lens.at("field_curvature_per_mm"),
             lens.at("field_curvature_growth_per_mm")};
  p->axis = lens.value("rotation_rad", std::array<double, 2>{});
  const auto pupil = lens.at("exit_pupil_mm").get<std::array<double, 3>>();
  p->pupil = {pupil[0], pupil[1], pupil[2], lens.value("pupil_aberration_per_mm", 0.0)};
  const Json &c = camera.at("principal_point_px"), &t = array.at("offset_mm");
  const Json& angles = array.at("rotation_rad");
  p->sensor = {c.at(0), c.at(1), array.at("mla_to_sensor_mm")};
  p->mla = {angles.at(0), angles.at(1), angles.at(2), t.at(0), t.at(1), array.at("lens_to_mla_mm")};
  p->pitch = {array.at("pitch_mm"), array.value("pitch_ratio", 1.0)};
  p->f = array.at("focal_lengths_mm").get<std::vector<double>>();
  for (const Json& entry : poses.at("poses")) {
    const Json& transform = entry.at("camera_from_board");
    const auto r = transform.at("rotation_vector_rad").get<std::array<double, 3>>();
    const auto shift = transform.at("translation_mm").get<std::array<double, 3>>();
    p->poses[entry.at("frame")] = {r[0], r[1], r[2], shift[0], shift[1], shift[2]};
  }
}

// ---- Problem -------------------------------------------------------------------------------

template <bool kRho>
void AddFeatures(const std::string& path, const Lattice& lattice, double pixel_size,
                 ceres::LossFunction* loss, Parameters* p, ceres::Problem* problem) {
  using Residual = FeatureResidual<kRho>;
  using Cost = ceres::AutoDiffCostFunction<Residual, Residual::kSize, kMainLensSize, kAxisSize,
                                           kSensorSize, kMlaSize, kPitchSize, 1, kPoseSize>;
  for (const auto& row : ReadCsv(path)) {
    const int k = static_cast<int>(row.at("k")), l = static_cast<int>(row.at("l"));
    const int type = lattice.Type(k, l, static_cast<int>(p->f.size()));
    auto* residual =
        new Residual{lattice.Node(k, l),
                     {row.at("x"), row.at("y"), row.at("z")},
                     row.at("u"),
                     row.at("v"),
                     kRho ? row.at("rho") : 0.0,
                     {row.at("std_u"), row.at("std_v"), kRho ? row.at("std_rho") : 1.0},
                     pixel_size};
    problem->AddResidualBlock(new Cost(residual), loss, p->lens.data(), p->axis.data(),
                              p->sensor.data(), p->mla.data(), p->pitch.data(), &p->f[type],
                              p->poses.at(static_cast<int>(row.at("frame"))).data());
  }
}

void AddCenters(const std::string& path, const Lattice& lattice, double pixel_size,
                ceres::LossFunction* loss, Parameters* p, ceres::Problem* problem) {
  using Cost = ceres::AutoDiffCostFunction<CenterResidual, 2, kAxisSize, kPupilSize, kSensorSize,
                                           kMlaSize, kPitchSize>;
  for (const auto& row : ReadCsv(path)) {
    const int k = static_cast<int>(row.at("k")), l = static_cast<int>(row.at("l"));
    auto* residual = new CenterResidual{lattice.Node(k, l), row.at("u"), row.at("v"),
                                        row.at("std_dev"), pixel_size};
    problem->AddResidualBlock(new Cost(residual), loss, p->axis.data(), p->pupil.data(),
                              p->sensor.data(), p->mla.data(), p->pitch.data());
  }
}

void AddPrior(const Json& prior, double weight, Parameters* p, ceres::Problem* problem) {
  const std::string quantity = prior.at("quantity");
  const double std_dev = prior.at("std_dev");
  const Known known{prior.at("value"), std::sqrt(weight) / std_dev};
  const auto names = p->Names();
  if (quantity == "m") {
    problem->AddResidualBlock(
        new ceres::AutoDiffCostFunction<SlopePrior, 1, kMainLensSize, kPupilSize, kSensorSize,
                                        kMlaSize>(new SlopePrior{known}),
        nullptr, p->lens.data(), p->pupil.data(), p->sensor.data(), p->mla.data());
  } else if (quantity.rfind("q'_", 0) == 0) {
    problem->AddResidualBlock(
        new ceres::AutoDiffCostFunction<InterceptPrior, 1, kSensorSize, kPitchSize, 1>(
            new InterceptPrior{known}),
        nullptr, p->sensor.data(), p->pitch.data(), names.at("f_" + quantity.substr(3)).block);
  } else if (quantity == "tilt_u" || quantity == "tilt_v") {
    problem->AddResidualBlock(
        new ceres::AutoDiffCostFunction<TiltGradientPrior, 1, kPupilSize, kSensorSize, kMlaSize>(
            new TiltGradientPrior{known, quantity == "tilt_u" ? 0 : 1}),
        nullptr, p->pupil.data(), p->sensor.data(), p->mla.data());
  } else {
    const auto [block, size, index] = names.at(quantity);
    auto* cost =
        new ceres::DynamicAutoDiffCostFunction<ParameterPrior>(new ParameterPrior{known, index});
    cost->AddParameterBlock(size);
    cost->SetNumResiduals(1);
    problem->AddResidualBlock(cost, nullptr, block);
  }
}

void Fix(const Json& fixed, Parameters* p, ceres::Problem* problem) {
  std::map<double*, std::vector<int>> constant;
  std::map<double*, int> sizes;
  for (const auto& [name, place] : p->Names()) {
    if (!problem->HasParameterBlock(place.block)) continue;
    sizes[place.block] = place.size;
    for (const Json& held : fixed)
      if (held == name) constant[place.block].push_back(place.index);
  }
  for (const auto& [block, indices] : constant) {
    if (static_cast<int>(indices.size()) == sizes[block])
      problem->SetParameterBlockConstant(block);
    else
      problem->SetManifold(block, new ceres::SubsetManifold(sizes[block], indices));
  }
}

// ---- Solve and write -----------------------------------------------------------------------

ceres::Solver::Summary Solve(int threads, bool verbose, Parameters* p, ceres::Problem* problem) {
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
  options.num_threads = threads;
  options.max_num_iterations = 500;
  options.function_tolerance = 1e-13;
  options.gradient_tolerance = 1e-12;
  options.parameter_tolerance = 1e-12;
  options.logging_type = ceres::SILENT;
  std::vector<double*> blocks;
  problem->GetParameterBlocks(&blocks);
  options.linear_solver_ordering.reset(new ceres::ParameterBlockOrdering);
  for (double* block : blocks) options.linear_solver_ordering->AddElementToGroup(block, 1);
  for (auto& [frame, pose] : p->poses)  // eliminated first
    options.linear_solver_ordering->AddElementToGroup(pose.data(), 0);
  ceres::Solver::Summary summary;
  ceres::Solve(options, problem, &summary);
  if (verbose) {
    for (const auto& i : summary.iterations)
      std::fprintf(stderr, "%3d cost %.9e change %9.2e gradient %8.2e radius %8.2e\n", i.iteration,
                   i.cost, i.cost_change, i.gradient_max_norm, i.trust_region_radius);
    std::cerr << summary.FullReport() << "\n";
  }
  if (!summary.IsSolutionUsable()) throw std::runtime_error("solver failed: " + summary.message);
  return summary;
}

// The document of the start with the values of the result.
Json CameraJson(Json camera, bool converged, const Parameters& p) {
  Json &lens = camera["main_lens"], &array = camera["micro_lens_array"];
  const char* names[] = {"focal_length_mm",
                         "q1_per_mm2",
                         "q2_per_mm4",
                         "q3_per_mm6",
                         "q1_growth_per_mm2",
                         "p1_per_mm",
                         "p2_per_mm",
                         "field_curvature_per_mm",
                         "field_curvature_growth_per_mm"};
  for (int i = 0; i < kMainLensSize; ++i) lens[names[i]] = p.lens[i];
  lens["rotation_rad"] = {p.axis[kOmegaX], p.axis[kOmegaY]};
  lens["exit_pupil_mm"] = {p.pupil[kEx], p.pupil[kEy], p.pupil[kEz]};
  lens["pupil_aberration_per_mm"] = p.pupil[kEr];
  camera["principal_point_px"] = {p.sensor[kU0], p.sensor[kV0]};
  array["mla_to_sensor_mm"] = p.sensor[kLittleD];
  array["rotation_rad"] = {p.mla[kThetaX], p.mla[kThetaY], p.mla[kThetaZ]};
  array["offset_mm"] = {p.mla[kTx], p.mla[kTy]};
  array["lens_to_mla_mm"] = p.mla[kBigD];
  array["pitch_mm"] = p.pitch[kPitch];
  array["pitch_ratio"] = p.pitch[kRatio];
  array["focal_lengths_mm"] = p.f;
  camera["converged"] = converged;
  return camera;
}

Json PosesJson(const Parameters& p) {
  Json poses = {{"format", "plenocal-poses"}, {"version", 1}, {"poses", Json::array()}};
  for (const auto& [frame, v] : p.poses)
    poses["poses"].push_back(
        {{"frame", frame},
         {"camera_from_board",
          {{"rotation_vector_rad", {v[0], v[1], v[2]}}, {"translation_mm", {v[3], v[4], v[5]}}}}});
  return poses;
}

void Write(const std::string& path, const Json& json) {
  std::ofstream file(path);
  file << json.dump(2) << "\n";
  if (!file.flush())
    throw std::runtime_error(path + ": cannot be written: " + std::strerror(errno));
}

ceres::LossFunction* LossFrom(const Json& loss) {
  const double scale = loss.at("scale");
  if (loss.at("kind") == "huber") return new ceres::HuberLoss(scale);
  if (loss.at("kind") == "cauchy") return new ceres::CauchyLoss(scale);
  return nullptr;
}

struct Arguments {
  std::string problem, out;
  int threads = 1;
  bool verbose = false;
};

Arguments Parse(int argc, char** argv) {
  Arguments arguments;
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i];
    const auto value = [&]() -> std::string {
      if (i + 1 == argc) throw std::runtime_error(word + ": value missing");
      return argv[++i];
    };
    if (word == "--out") {
      arguments.out = value();
    } else if (word == "--threads") {
      const std::string number = value();
      arguments.threads = std::atoi(number.c_str());
      if (arguments.threads < 1) throw std::runtime_error("--threads: at least 1, not " + number);
    } else if (word == "--verbose") {
      arguments.verbose = true;
    } else if (word[0] == '-' || !arguments.problem.empty()) {
      throw std::runtime_error(word + ": unknown option; see --help");
    } else {
      arguments.problem = word;
    }
  }
  if (arguments.problem.empty() || arguments.out.empty())
    throw std::runtime_error("a problem and --out are needed; see --help");
  return arguments;
}

void Run(const Arguments& arguments) {
  const std::string folder = arguments.problem + "/";
  const Json options = ReadJson(folder + "problem.json"), camera = ReadJson(folder + "camera.json");
  Lattice lattice;
  Parameters p;
  if (camera.at("micro_lens_array").at("focal_lengths_mm").empty())
    throw std::runtime_error("camera.json: the array has no lens type");
  ReadStart(camera, ReadJson(folder + "poses.json"), &lattice, &p);
  const double pixel_size = camera.at("sensor").at("pixel_size_mm");
  for (const char* name : {"sag_x", "sag_y", "twist", "aspect"}) {
    const auto& fixed = options.at("fixed");
    if (std::find(fixed.begin(), fixed.end(), name) == fixed.end())
      throw std::runtime_error("problem.json: the shape of the board is free (--board flat)");
  }
  ceres::Problem problem;
  ceres::LossFunction* loss = LossFrom(options.at("loss"));
  if (options.at("rho").get<bool>())
    AddFeatures<true>(folder + "features.csv", lattice, pixel_size, loss, &p, &problem);
  else
    AddFeatures<false>(folder + "features.csv", lattice, pixel_size, loss, &p, &problem);
  AddCenters(folder + "centers.csv", lattice, pixel_size, loss, &p, &problem);
  for (const Json& prior : options.at("priors"))
    AddPrior(prior, options.at("prior_weight"), &p, &problem);
  Fix(options.at("fixed"), &p, &problem);

  // Before the solve, which would be in vain.
  std::error_code error;
  std::filesystem::create_directories(arguments.out, error);
  if (error)
    throw std::runtime_error(arguments.out + ": the folder cannot be made: " + error.message());

  const auto start = std::chrono::steady_clock::now();
  const ceres::Solver::Summary summary = Solve(arguments.threads, arguments.verbose, &p, &problem);
  const std::chrono::duration<double> time = std::chrono::steady_clock::now() - start;
  const bool converged = summary.termination_type == ceres::CONVERGENCE;
  Write(arguments.out + "/camera.json", CameraJson(camera, converged, p));
  Write(arguments.out + "/poses.json", PosesJson(p));
  const Json result = {{"cost", summary.final_cost},
                       {"initial_cost", summary.initial_cost},
                       {"iterations", summary.iterations.size() - 1},
                       {"time_s", time.count()},
                       {"converged", converged}};
  std::cout << result.dump(2) << "\n";
}

}  // namespace

int main(int argc, char** argv) {
  google::InitGoogleLogging(argv[0]);
  for (int i = 1; i < argc; ++i) {
    if (std::string(argv[i]) == "--help") {
      std::cout << kHelp;
      return 0;
    }
  }
  try {
    Run(Parse(argc, argv));
  } catch (const std::exception& error) {
    std::cerr << "plain_ceres: " << error.what() << "\n";
    return 1;
  }
  return 0;
}
