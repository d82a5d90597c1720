// Observations and complete problems.
#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "document.hpp"
#include "table.hpp"

namespace plenocal {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr int kVersion = 1;

std::vector<CenterObservation> read_centers(const std::string& path) {
  Table table(path, {"k", "l", "u", "v"});
  std::vector<CenterObservation> centers;
  while (table.next()) {
    centers.push_back({table.integer("k"),
                       table.integer("l"),
                       {table.number("u"), table.number("v")},
                       table.std_dev_or("std_dev", 1.0)});
  }
  return centers;
}

FeatureObservation feature_in(const Table& table) {
  FeatureObservation f;
  f.k = table.integer("k");
  f.l = table.integer("l");
  f.observed = {table.number("u"), table.number("v"), table.number_or("rho", kNan)};
  f.std_dev = {table.std_dev_or("std_u", 1.0), table.std_dev_or("std_v", 1.0),
               table.std_dev_or("std_rho", 1.0)};
  return f;
}

// Replaces the number in `frame` of each feature by its index, and returns the numbers.
std::vector<int> number_frames(std::vector<FeatureObservation>* features) {
  std::set<int> numbers;
  for (const auto& f : *features) numbers.insert(f.frame);
  const std::vector<int> frames(numbers.begin(), numbers.end());
  for (auto& f : *features) {
    f.frame =
        static_cast<int>(std::lower_bound(frames.begin(), frames.end(), f.frame) - frames.begin());
  }
  return frames;
}

Loss loss_from(const Field& loss) {
  const std::string kind = loss["kind"].string();
  const double scale = loss["scale"].number();
  if (kind == "none") return {LossKind::kNone, scale};
  if (kind == "huber") return {LossKind::kHuber, scale};
  if (kind == "cauchy") return {LossKind::kCauchy, scale};
  loss["kind"].reject("none, huber or cauchy");
}

}  // namespace

ObservationFiles read_observations(const std::string& features, const std::string& centers,
                                   const BoardGrid& board) {
  if (board.columns < 1 || board.rows < 1 || !(board.square > 0.0 && board.square < HUGE_VAL)) {
    throw std::invalid_argument("a board has columns and rows of corners, and squares with a size");
  }
  ObservationFiles files;
  files.observations.board = board.board();
  Table table(features, {"k", "l", "u", "v", "cluster", "frame"});
  while (table.next()) {
    FeatureObservation f = feature_in(table);
    f.frame = table.integer("frame");
    const int corner = table.integer("cluster");
    if (corner < 0 || corner >= static_cast<long long>(board.columns) * board.rows) {
      table.reject("corner " + std::to_string(corner) + " is not on the board");
    }
    f.board_point = board.corner(corner);
    files.observations.features.push_back(f);
    files.corners.push_back(corner);
  }
  if (files.corners.empty()) fail(features, "contains no observations");
  files.frames = number_frames(&files.observations.features);
  if (!centers.empty()) files.observations.centers = read_centers(centers);
  return files;
}

Observations ProblemFiles::with_frames(const std::vector<int>& of_other) const {
  std::map<int, int> index;
  for (std::size_t i = 0; i < of_other.size(); ++i) index[of_other[i]] = static_cast<int>(i);
  Observations result = observations;
  result.features.clear();
  for (FeatureObservation f : observations.features) {
    const auto found = index.find(frames.at(f.frame));
    if (found == index.end()) continue;
    f.frame = found->second;
    result.features.push_back(f);
  }
  return result;
}

ProblemFiles read_problem(const std::string& folder) {
  const std::string path = folder + "/problem.json";
  const Json json = document(path, "plenocal-problem", kVersion);
  const Field root(json, path, "");
  ProblemFiles problem;
  problem.start = read_camera(folder + "/camera.json");
  for (const auto& [frame, pose] : read_poses(folder + "/poses.json")) {
    problem.frames.push_back(frame);
    problem.poses.push_back(pose);
  }
  Table table(folder + "/features.csv", {"frame", "x", "y", "z", "k", "l", "u", "v"});
  while (table.next()) {
    FeatureObservation f = feature_in(table);
    const int number = table.integer("frame");
    const auto at = std::lower_bound(problem.frames.begin(), problem.frames.end(), number);
    if (at == problem.frames.end() || *at != number) {
      table.reject("frame " + std::to_string(number) + " has no pose in poses.json");
    }
    f.frame = static_cast<int>(at - problem.frames.begin());
    f.board_point = {table.number("x"), table.number("y"), table.number("z")};
    problem.observations.features.push_back(f);
  }
  problem.observations.centers = read_centers(folder + "/centers.csv");
  const Field board = root["board"];
  problem.observations.board = {board["half_width_mm"].number(), board["half_height_mm"].number()};
  const Parameter* parameter = kBoardShapeTable;
  BoardShape<double>::visit(problem.observations.board.shape, [&](const char*, double& value) {
    value = board.at_pointer((parameter++)->key).number();
  });
  CostOptions& options = problem.options;
  options.rho = root["rho"].boolean();
  options.features_loss = options.centers_loss = loss_from(root["loss"]);
  // Problems exported before 0.1.0 call priors anchors.
  const bool is_earlier = root.has("anchors");
  options.prior_weight = root[is_earlier ? "anchor_weight" : "prior_weight"].number();
  options.fixed.clear();
  const Field fixed = root["fixed"], priors = root[is_earlier ? "anchors" : "priors"];
  for (std::size_t i = 0; i < fixed.size(); ++i) options.fixed.insert(fixed.at(i).string());
  for (std::size_t i = 0; i < priors.size(); ++i) {
    const Field prior = priors.at(i);
    std::string quantity = prior["quantity"].string();
    if (is_earlier && quantity.rfind("lean_", 0) == 0) quantity.replace(0, 4, "tilt");
    options.priors.push_back({quantity, prior["value"].number(), prior["std_dev"].number()});
  }
  return problem;
}

}  // namespace plenocal
