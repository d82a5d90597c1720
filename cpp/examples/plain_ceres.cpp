// Calibrates a focused (Galilean) three-type hexagonal plenoptic camera with plain Ceres: one
// auto-diff residual block per observation, DENSE_SCHUR, default trust region, no tricks. It is an
// independent oracle for the library's answers and the baseline of its benchmarks, and therefore
// uses none of its headers. Equations are those of "Blur Aware Calibration of Multi-Focus Plenoptic
// Camera" (CVPR 2020).
//
// Long because it is self-contained: one file that anybody can compile and compare with.
//
// Lengths are in mm, angles in rad, image quantities in px; pixel (0, 0) is the centre of the
// top-left pixel. Camera frame: origin O at the main-lens centre, z towards the scene, x right,
// y down. The image is stored upright, so the pixel axes run against the camera axes:
//     u = u0 - x/s,  v = v0 - y/s   for the point (x, y) of the sensor plane z = -(D + d).
//
//   g++ -O3 -std=c++17 plain_ceres.cpp -I/usr/include/eigen3 -lceres -lglog -o plain_ceres

#include <ceres/ceres.h>
#include <ceres/rotation.h>
#include <glog/logging.h>

#include <Eigen/Dense>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <limits>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace {

constexpr int kTypes = 3;

// ---- Input ---------------------------------------------------------------------------------

struct Options {
  std::string centers, features, poses;
  double pixel_size_mm, focal_mm, focus_mm, m_mm, square_mm;
  int width, height, columns, rows, board_columns;
  std::vector<double> q_mm;
  int threads = 1;
  bool two_pitches = false, verbose = false;
};

// A micro-image centre or, with rho, cluster and frame, a BAP feature.
struct Observation {
  int k, l;
  double u, v;
  double rho = 0.0;
  int cluster = 0, frame = 0;
};

std::vector<std::string> Split(const std::string& text) {
  std::vector<std::string> fields;
  std::stringstream stream(text);
  for (std::string field; std::getline(stream, field, ',');) {
    field.erase(0, field.find_first_not_of(" \t\r"));
    field.erase(field.find_last_not_of(" \t\r") + 1);
    fields.push_back(field);
  }
  return fields;
}

double ToNumber(const std::string& text, const std::string& what) {
  char* end = nullptr;
  const double value = std::strtod(text.c_str(), &end);
  if (text.empty() || *end != '\0' || !std::isfinite(value))
    throw std::runtime_error(what + ": '" + text + "' is not a finite number");
  return value;
}

// An integer in [low, high].
int ToInteger(const std::string& text, const std::string& what, int low, int high) {
  const double value = ToNumber(text, what);
  if (value != std::floor(value) || value < low || value > high)
    throw std::runtime_error(what + ": '" + text + "' is not an integer from " +
                             std::to_string(low) + " to " + std::to_string(high));
  return static_cast<int>(value);
}

Options ParseCommandLine(int argc, char** argv) {
  std::map<std::string, std::string> given;
  for (int i = 1; i < argc; ++i) {
    const std::string name = argv[i];
    const bool is_flag = name == "--two-pitches" || name == "--verbose";
    if (!is_flag && i + 1 == argc) throw std::runtime_error(name + ": value missing");
    if (!given.emplace(name, is_flag ? "" : argv[++i]).second)
      throw std::runtime_error(name + ": given twice");
  }
  const auto take = [&given](const std::string& name) {
    const auto node = given.extract(name);
    if (node.empty()) throw std::runtime_error(name + ": option missing");
    return node.mapped();
  };
  const auto positive = [](const std::string& text, const std::string& name) {
    const double value = ToNumber(text, name);
    if (value <= 0.0) throw std::runtime_error(name + ": must be positive");
    return value;
  };
  const auto length = [&](const std::string& name) { return positive(take(name), name); };
  const auto count = [&](const std::string& name) {
    return ToInteger(take(name), name, 1, 1000000);
  };
  Options options;
  options.centers = take("--centers");
  options.features = take("--features");
  options.pixel_size_mm = length("--pixel-size-mm");
  options.width = count("--width");
  options.height = count("--height");
  options.columns = count("--columns");
  options.rows = count("--rows");
  options.focal_mm = length("--focal-mm");
  options.focus_mm = length("--focus-mm");
  options.m_mm = length("--m-mm");
  for (const std::string& q : Split(take("--q-mm"))) options.q_mm.push_back(positive(q, "--q-mm"));
  options.board_columns = count("--board-columns");
  options.square_mm = length("--square-mm");
  if (given.count("--poses")) options.poses = take("--poses");
  if (given.count("--threads")) options.threads = count("--threads");
  options.two_pitches = given.erase("--two-pitches") > 0;
  options.verbose = given.erase("--verbose") > 0;
  if (!given.empty()) throw std::runtime_error(given.begin()->first + ": unknown option");
  if (options.q_mm.size() != kTypes) throw std::runtime_error("--q-mm: three values expected");
  if (options.focus_mm < 4.0 * options.focal_mm)
    throw std::runtime_error("--focus-mm: must be at least four focal lengths");
  return options;
}

std::vector<Observation> ReadCsv(const std::string& path, bool is_features, const Options& o) {
  std::ifstream file(path);
  std::string line;
  if (!std::getline(file, line)) throw std::runtime_error(path + ": cannot read a header line");
  std::map<std::string, size_t> column;
  const std::vector<std::string> header = Split(line);
  for (size_t i = 0; i < header.size(); ++i) column[header[i]] = i;

  std::vector<Observation> observations;
  for (int number = 2; std::getline(file, line); ++number) {
    const std::vector<std::string> fields = Split(line);
    if (fields.empty() || (fields.size() == 1 && fields[0].empty())) continue;
    const std::string where = path + ":" + std::to_string(number) + ": ";
    if (fields.size() != header.size())
      throw std::runtime_error(where + std::to_string(header.size()) + " fields expected");
    const auto field = [&](const char* name) -> const std::string& {
      if (!column.count(name)) throw std::runtime_error(path + ": no column '" + name + "'");
      return fields[column[name]];
    };
    constexpr int kMax = std::numeric_limits<int>::max();
    Observation x;
    x.k = ToInteger(field("k"), where + "k", 0, o.columns - 1);
    x.l = ToInteger(field("l"), where + "l", 0, o.rows - 1);
    x.u = ToNumber(field("u"), where + "u");
    x.v = ToNumber(field("v"), where + "v");
    if (is_features) {
      x.rho = ToNumber(field("rho"), where + "rho");
      x.cluster = ToInteger(field("cluster"), where + "cluster", 0, kMax);
      x.frame = ToInteger(field("frame"), where + "frame", 0, kMax);
    }
    observations.push_back(x);
  }
  if (observations.empty()) throw std::runtime_error(path + ": no observation");
  return observations;
}

// ---- Lattice -------------------------------------------------------------------------------

// Hexagonal, row-aligned lattice in units of the pitch; every other row is shifted by one half.
struct Lattice {
  int columns, rows;
  int shifted_parity = 0;  // of the shifted rows' l

  // g(k, l) - g_c, with g_c the middle of the bounding box of all nodes.
  Eigen::Vector2d Node(int k, int l) const {
    const Eigen::Vector2d g(k + (l % 2 == shifted_parity ? 0.5 : 0.0), std::sqrt(0.75) * l);
    return g - Eigen::Vector2d(0.5 * (columns - 0.5), 0.5 * std::sqrt(0.75) * (rows - 1));
  }
  // The lattice's three-colouring, in which no two neighbours have the same type.
  int Type(int k, int l) const { return ((shifted_parity == 0 ? 1 : 2) * (l % 2) + k) % kTypes; }
};

Eigen::Vector2d BoardPoint(int cluster, const Options& o) {  // mm, in the plane z = 0
  return o.square_mm * Eigen::Vector2d(cluster % o.board_columns, cluster / o.board_columns);
}

// ---- Camera model --------------------------------------------------------------------------

// Parameter blocks. A pose is the angle-axis rotation and the translation of camera from board.
enum MainLens { kF, kQ1, kQ2, kQ3, kP1, kP2, kMainLensSize };
enum Sensor { kU0, kV0, kLittleD, kSensorSize };
enum Mla { kThetaX, kThetaY, kThetaZ, kTx, kTy, kBigD, kMlaSize };
constexpr int kPoseSize = 6;

// Micro-lens centre C = Rz Ry Rx node + (tx, ty, -D), where node = -dC (g - g_c): the minus sign
// because k grows with u and u runs against x. The pitch is one number or one per lattice axis.
template <int kPitches, typename T>
void MicroLensCenter(const Eigen::Vector2d& g, const T* mla, const T* pitch, T C[3]) {
  using std::cos;
  using std::sin;
  const T x = -pitch[0] * g.x(), y = -pitch[kPitches - 1] * g.y();
  const T cx = cos(mla[kThetaX]), sx = sin(mla[kThetaX]);
  const T cy = cos(mla[kThetaY]), sy = sin(mla[kThetaY]);
  const T cz = cos(mla[kThetaZ]), sz = sin(mla[kThetaZ]);
  const T x1 = cy * x + sy * sx * y, y1 = cx * y;  // Ry Rx (x, y, 0)
  C[0] = cz * x1 - sz * y1 + mla[kTx];
  C[1] = sz * x1 + cz * y1 + mla[kTy];
  C[2] = -sy * x + cy * sx * y - mla[kBigD];
}

// Micro-image centre: where the ray from O through C meets the sensor plane.
template <int kPitches>
struct CenterResidual {
  Eigen::Vector2d g;
  double u, v, pixel_size;

  template <typename T>
  bool operator()(const T* sensor, const T* mla, const T* pitch, T* residual) const {
    T C[3];
    MicroLensCenter<kPitches>(g, mla, pitch, C);
    const T scale = -(mla[kBigD] + sensor[kLittleD]) / C[2];
    residual[0] = sensor[kU0] - scale * C[0] / pixel_size - u;
    residual[1] = sensor[kV0] - scale * C[1] / pixel_size - v;
    return true;
  }
};

// BAP feature: board corner through main lens and micro-lens, and the radius of its blur.
template <int kPitches>
struct FeatureResidual {
  Eigen::Vector2d g, board_point;
  double u, v, rho, pixel_size;

  template <typename T>
  bool operator()(const T* main_lens, const T* sensor, const T* mla, const T* pitch, const T* f,
                  const T* pose, T* residual) const {
    using std::sqrt;
    const T p_w[3] = {T(board_point.x()), T(board_point.y()), T(0.0)};
    T p[3];
    ceres::AngleAxisRotatePoint(pose, p_w, p);  // p_c = R p_w + t
    for (int i = 0; i < 3; ++i) p[i] += pose[3 + i];

    const T lens = -main_lens[kF] / (p[2] - main_lens[kF]);  // thin lens: p' = -F/(z_c - F) p_c
    const T x = lens * p[0], y = lens * p[1], z = lens * p[2];

    // Brown-Conrady distortion of (x', y') in mm.
    const T *Q = main_lens + kQ1, *P = main_lens + kP1;
    const T r2 = x * x + y * y;
    const T radial = r2 * (Q[0] + r2 * (Q[1] + r2 * Q[2]));
    const T xd = x + x * radial + P[0] * (r2 + 2.0 * x * x) + 2.0 * P[1] * x * y;
    const T yd = y + y * radial + P[1] * (r2 + 2.0 * y * y) + 2.0 * P[0] * x * y;

    // Where the ray from C through p' meets the sensor plane z = -(D + d).
    T C[3];
    MicroLensCenter<kPitches>(g, mla, pitch, C);
    const T a = z - C[2];                                  // micro-lens to p'
    const T delta = C[2] + mla[kBigD] + sensor[kLittleD];  // micro-lens to sensor
    const T x_sensor = C[0] - delta / a * (xd - C[0]);
    const T y_sensor = C[1] - delta / a * (yd - C[1]);

    // Blur radius: rho = dC/(2s) delta (1/f_i - 1/a - 1/delta).
    const T dC = kPitches == 1 ? pitch[0] : sqrt(pitch[0] * pitch[kPitches - 1]);
    residual[0] = sensor[kU0] - x_sensor / pixel_size - u;
    residual[1] = sensor[kV0] - y_sensor / pixel_size - v;
    residual[2] = dC / (2.0 * pixel_size) * delta * (1.0 / f[0] - 1.0 / a - 1.0 / delta) - rho;
    return true;
  }
};

struct Parameters {
  std::array<double, kMainLensSize> main_lens{};
  std::array<double, kSensorSize> sensor{};
  std::array<double, kMlaSize> mla{};
  std::array<double, 2> pitch{};  // only runs with two pitches use the second
  std::array<double, kTypes> f{};
  std::map<int, std::array<double, kPoseSize>> poses;
};

// ---- Initial values ------------------------------------------------------------------------

// Fits (u, v) = (a g_x - b g_y + c, b g_x + a g_y + e), a lattice of pitch |(a, b)| rotated by
// atan2(b, a), with either parity of the shifted rows, and keeps the better fit.
Eigen::Vector4d FitLattice(const std::vector<Observation>& centers, Lattice* lattice) {
  if (centers.size() < 3) throw std::runtime_error("fewer than three micro-image centres");
  Eigen::Vector4d best_fit;
  double best_cost = std::numeric_limits<double>::infinity();
  int best_parity = 0;
  for (int parity : {0, 1}) {
    lattice->shifted_parity = parity;
    Eigen::MatrixX4d A(2 * centers.size(), 4);
    Eigen::VectorXd b(2 * centers.size());
    for (size_t i = 0; i < centers.size(); ++i) {
      const Eigen::Vector2d g = lattice->Node(centers[i].k, centers[i].l);
      A.row(2 * i) << g.x(), -g.y(), 1.0, 0.0;
      A.row(2 * i + 1) << g.y(), g.x(), 0.0, 1.0;
      b.segment<2>(2 * i) << centers[i].u, centers[i].v;
    }
    const Eigen::Vector4d fit = A.colPivHouseholderQr().solve(b);
    const double cost = (A * fit - b).squaredNorm();
    if (cost < best_cost) {
      best_cost = cost;
      best_fit = fit;
      best_parity = parity;
    }
  }
  lattice->shifted_parity = best_parity;
  return best_fit;
}

// Intrinsics from the internal parameters m, q'_i (the paper's section "Parameters
// initialization") and from the lattice fitted to the micro-image centres.
void InitializeIntrinsics(const Options& o, const std::vector<Observation>& centers,
                          Lattice* lattice, Parameters* p) {
  const Eigen::Vector4d fit = FitLattice(centers, lattice);
  const double F = o.focal_mm, h = o.focus_mm;
  const double H = std::abs(h / 2.0 * (1.0 - std::sqrt(1.0 - 4.0 * F / h)));  // Galilean
  const double d = 2.0 * o.m_mm * H / (F + 4.0 * o.m_mm);
  const double D = H - 2.0 * d;
  const double image_pitch = o.pixel_size_mm * std::hypot(fit[0], fit[1]);  // of micro-images
  const double dC = image_pitch * D / (D + d);
  p->main_lens[kF] = F;  // and no distortion
  p->sensor = {0.5 * (o.width - 1), 0.5 * (o.height - 1), d};
  p->pitch = {dC, dC};
  for (int i = 0; i < kTypes; ++i) p->f[i] = d * dC / (2.0 * o.q_mm[i]);
  // Inverting both axes is a rotation, so the rotation in the image is that of the MLA.
  p->mla = {0.0, 0.0, std::atan2(fit[1], fit[0]), 0.0, 0.0, D};

  // The centres are linear in the offset: choose it to make their mean residual zero.
  Eigen::Vector2d mean = Eigen::Vector2d::Zero();
  for (const Observation& c : centers) {
    const CenterResidual<1> error{lattice->Node(c.k, c.l), c.u, c.v, o.pixel_size_mm};
    Eigen::Vector2d residual;
    error(p->sensor.data(), p->mla.data(), p->pitch.data(), residual.data());
    mean += residual / static_cast<double>(centers.size());
  }
  p->mla[kTx] = mean.x() * o.pixel_size_mm * D / (D + d);
  p->mla[kTy] = mean.y() * o.pixel_size_mm * D / (D + d);
}

// Pose of a planar board from pairs (board point, normalised image point x_c/z_c, y_c/z_c): the
// homography [r1 r2 t] by direct linear transform, then the rotation nearest to (r1, r2, r1 x r2).
std::array<double, kPoseSize> PoseFromHomography(
    const std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>>& pairs, double unit,
    const std::string& where) {
  Eigen::MatrixXd A = Eigen::MatrixXd::Zero(2 * pairs.size(), 9);
  for (size_t i = 0; i < pairs.size(); ++i) {
    const Eigen::Vector2d& n = pairs[i].second;
    const Eigen::RowVector3d b(pairs[i].first.x() / unit, pairs[i].first.y() / unit, 1.0);
    A.block<1, 3>(2 * i, 0) = b;
    A.block<1, 3>(2 * i, 6) = -n.x() * b;
    A.block<1, 3>(2 * i + 1, 3) = b;
    A.block<1, 3>(2 * i + 1, 6) = -n.y() * b;
  }
  const Eigen::JacobiSVD<Eigen::MatrixXd> dlt(A, Eigen::ComputeFullV);
  if (dlt.singularValues()[7] < 1e-10 * dlt.singularValues()[0])
    throw std::runtime_error(where + ": board corners are collinear, no pose");
  const Eigen::Matrix<double, 9, 1> h = dlt.matrixV().col(8);
  Eigen::Matrix3d M = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(h.data());
  M.leftCols<2>() /= unit;
  M /= std::copysign(0.5 * (M.col(0).norm() + M.col(1).norm()), M(2, 2));  // board in front
  Eigen::Matrix3d R;
  R << M.col(0), M.col(1), M.col(0).cross(M.col(1));
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(R, Eigen::ComputeFullU | Eigen::ComputeFullV);
  R = svd.matrixU() * svd.matrixV().transpose();
  std::array<double, kPoseSize> pose;
  ceres::RotationMatrixToAngleAxis(R.data(), pose.data());
  Eigen::Map<Eigen::Vector3d>(pose.data() + 3) = M.col(2);
  return pose;
}

// The barycentre of a cluster is nearly the pinhole projection u = u0 + (D+d)/s x_c/z_c.
void InitializePoses(const Options& o, const std::vector<Observation>& features, Parameters* p) {
  std::map<int, std::map<int, Eigen::Vector3d>> sums;  // frame, cluster: sum of (u, v, 1)
  for (const Observation& x : features)
    sums[x.frame].try_emplace(x.cluster, 0.0, 0.0, 0.0).first->second +=
        Eigen::Vector3d(x.u, x.v, 1.0);
  const Eigen::Vector2d center(p->sensor[kU0], p->sensor[kV0]);
  const double focal_px = (p->mla[kBigD] + p->sensor[kLittleD]) / o.pixel_size_mm;
  for (const auto& [frame, clusters] : sums) {
    const std::string where = o.features + ": frame " + std::to_string(frame);
    std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> pairs;
    for (const auto& [cluster, sum] : clusters)
      pairs.emplace_back(BoardPoint(cluster, o), (sum.hnormalized() - center) / focal_px);
    if (pairs.size() < 4) throw std::runtime_error(where + ": fewer than four board corners");
    const auto pose = PoseFromHomography(pairs, o.square_mm, where);
    for (const auto& pair : pairs) {
      const double p_w[3] = {pair.first.x(), pair.first.y(), 0.0};
      double p_c[3];
      ceres::AngleAxisRotatePoint(pose.data(), p_w, p_c);
      if (!(p_c[2] + pose[5] > o.focal_mm))
        throw std::runtime_error(where + ": no initial pose beyond the focal length");
    }
    p->poses[frame] = pose;
  }
}

// Poses from a CSV file frame,rx,ry,rz,tx,ty,tz instead. A small board far away looks the same if
// it is tilted the other way, and the homography may give the wrong one of the two poses.
void ReadPoses(const Options& o, Parameters* p) {
  std::ifstream file(o.poses);
  std::string line;
  if (!std::getline(file, line)) throw std::runtime_error(o.poses + ": cannot read a header line");
  while (std::getline(file, line)) {
    const std::vector<std::string> fields = Split(line);
    if (fields.size() != 1 + kPoseSize) throw std::runtime_error(o.poses + ": 7 columns expected");
    auto& pose = p->poses[ToInteger(fields[0], o.poses, 0, std::numeric_limits<int>::max())];
    for (int i = 0; i < kPoseSize; ++i) pose[i] = ToNumber(fields[1 + i], o.poses);
  }
}

// ---- Solve and report ----------------------------------------------------------------------

template <int kPitches>
void Calibrate(const Options& o, const Lattice& lattice, const std::vector<Observation>& centers,
               const std::vector<Observation>& features, Parameters* p) {
  using FeatureCost = ceres::AutoDiffCostFunction<FeatureResidual<kPitches>, 3, kMainLensSize,
                                                  kSensorSize, kMlaSize, kPitches, 1, kPoseSize>;
  using CenterCost =
      ceres::AutoDiffCostFunction<CenterResidual<kPitches>, 2, kSensorSize, kMlaSize, kPitches>;
  ceres::Problem problem;
  ceres::Problem::EvaluateOptions in_order;  // features, then centres
  for (const Observation& x : features) {
    auto* cost = new FeatureCost(new FeatureResidual<kPitches>{
        lattice.Node(x.k, x.l), BoardPoint(x.cluster, o), x.u, x.v, x.rho, o.pixel_size_mm});
    in_order.residual_blocks.push_back(problem.AddResidualBlock(
        cost, nullptr, p->main_lens.data(), p->sensor.data(), p->mla.data(), p->pitch.data(),
        &p->f[lattice.Type(x.k, x.l)], p->poses.at(x.frame).data()));
  }
  for (const Observation& x : centers) {
    auto* cost = new CenterCost(
        new CenterResidual<kPitches>{lattice.Node(x.k, x.l), x.u, x.v, o.pixel_size_mm});
    in_order.residual_blocks.push_back(
        problem.AddResidualBlock(cost, nullptr, p->sensor.data(), p->mla.data(), p->pitch.data()));
  }

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.trust_region_strategy_type = ceres::LEVENBERG_MARQUARDT;
  options.num_threads = o.threads;
  options.max_num_iterations = 500;
  options.function_tolerance = 1e-13;
  options.gradient_tolerance = 1e-12;
  options.parameter_tolerance = 1e-12;
  options.logging_type = ceres::SILENT;
  std::vector<double*> blocks;
  problem.GetParameterBlocks(&blocks);
  options.linear_solver_ordering.reset(new ceres::ParameterBlockOrdering);
  for (double* block : blocks) options.linear_solver_ordering->AddElementToGroup(block, 1);
  for (auto& [frame, pose] : p->poses)  // eliminated first
    options.linear_solver_ordering->AddElementToGroup(pose.data(), 0);

  ceres::Solver::Summary summary;
  const auto start = std::chrono::steady_clock::now();
  ceres::Solve(options, &problem, &summary);
  const std::chrono::duration<double> time = std::chrono::steady_clock::now() - start;
  if (o.verbose) {  // on stderr: stdout is for the result
    for (const auto& i : summary.iterations)
      std::fprintf(stderr, "%3d cost %.9e change %9.2e gradient %8.2e radius %8.2e\n", i.iteration,
                   i.cost, i.cost_change, i.gradient_max_norm, i.trust_region_radius);
    std::cerr << summary.FullReport() << "\n";
  }
  if (!summary.IsSolutionUsable()) throw std::runtime_error("solver failed: " + summary.message);

  std::vector<double> residuals;
  problem.Evaluate(in_order, nullptr, &residuals, nullptr, nullptr);
  const Eigen::Map<const Eigen::Matrix3Xd> r(residuals.data(), 3, features.size());
  const Eigen::Map<const Eigen::VectorXd> rc(residuals.data() + r.size(), 2 * centers.size());
  const double n = static_cast<double>(features.size());  // means are per feature, per centre
  const double uv2 = r.topRows<2>().squaredNorm() / n, rho2 = r.row(2).squaredNorm() / n;
  const double centers2 = rc.squaredNorm() / static_cast<double>(centers.size());

  const auto array = [](const double* values, int size) {
    std::string text = "[";
    for (int i = 0; i < size; ++i) {
      char number[32];
      std::snprintf(number, sizeof number, "%s%.17g", i ? ", " : "", values[i]);
      text += number;
    }
    return text + "]";
  };
  std::printf("{\n  \"cost\": %.17g,\n  \"initial_cost\": %.17g,\n", summary.final_cost,
              summary.initial_cost);
  std::printf("  \"iterations\": %zu,\n  \"time_s\": %.3f,\n  \"converged\": %s,\n",
              summary.iterations.size() - 1, time.count(),
              summary.termination_type == ceres::CONVERGENCE ? "true" : "false");
  std::printf("  \"rmse\": {\"all\": %.17g, \"uv\": %.17g, \"rho\": %.17g, \"centers\": %.17g},\n",
              std::sqrt(uv2 + rho2), std::sqrt(uv2), std::sqrt(rho2), std::sqrt(centers2));
  std::printf("  \"parameters\": {\n    \"focal_length_mm\": %.17g,\n", p->main_lens[kF]);
  std::printf("    \"radial\": %s,\n", array(&p->main_lens[kQ1], 3).c_str());
  std::printf("    \"tangential\": %s,\n", array(&p->main_lens[kP1], 2).c_str());
  std::printf("    \"principal_point_px\": %s,\n", array(&p->sensor[kU0], 2).c_str());
  std::printf("    \"mla_to_sensor_mm\": %.17g,\n", p->sensor[kLittleD]);
  std::printf("    \"mla_rotation_rad\": %s,\n", array(&p->mla[kThetaX], 3).c_str());
  std::printf("    \"mla_offset_mm\": %s,\n", array(&p->mla[kTx], 2).c_str());
  std::printf("    \"lens_to_mla_mm\": %.17g,\n", p->mla[kBigD]);
  std::printf("    \"micro_lens_pitch_mm\": %s,\n", array(p->pitch.data(), kPitches).c_str());
  std::printf("    \"micro_lens_focal_lengths_mm\": %s\n  }\n}\n",
              array(p->f.data(), kTypes).c_str());
}

}  // namespace

int main(int argc, char** argv) {
  google::InitGoogleLogging(argv[0]);
  try {
    const Options options = ParseCommandLine(argc, argv);
    const std::vector<Observation> centers = ReadCsv(options.centers, false, options);
    const std::vector<Observation> features = ReadCsv(options.features, true, options);
    Lattice lattice{options.columns, options.rows};
    Parameters parameters;
    InitializeIntrinsics(options, centers, &lattice, &parameters);
    InitializePoses(options, features, &parameters);
    if (!options.poses.empty()) ReadPoses(options, &parameters);
    if (options.two_pitches)
      Calibrate<2>(options, lattice, centers, features, &parameters);
    else
      Calibrate<1>(options, lattice, centers, features, &parameters);
  } catch (const std::exception& error) {
    std::cerr << "plain_ceres: " << error.what() << "\n";
    return 1;
  }
  return 0;
}
