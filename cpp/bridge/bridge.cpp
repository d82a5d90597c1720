#include "bridge.hpp"

#include <glog/logging.h>

#include <algorithm>
#include <limits>

#include "plenocal/src/solver/bridge.rs.h"

namespace plenocal::bridge {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

// Returns the results of a function for all items: mapped<std::vector>(items, f).
template <template <typename...> class List, typename Items, typename F>
auto mapped(const Items& items, F&& f) {
  List<std::decay_t<decltype(f(*items.begin()))>> results;
  results.reserve(items.size());
  for (const auto& item : items) results.push_back(f(item));
  return results;
}

int to_core(std::size_t n) {
  return static_cast<int>(std::min<std::size_t>(n, std::numeric_limits<int>::max()));
}

Camera to_core(const CameraParts& parts) {
  Camera camera;
  camera.lattice = {parts.packing, parts.columns, parts.rows};
  camera.pixel_size = parts.pixel_size_mm;
  camera.micro_lens_focal_lengths.resize(parts.lens_types);
  auto next = parts.parameters.begin();
  for_each_parameter(camera, [&next](const std::string&, double& value) { value = *next++; });
  return camera;
}

Board to_core(const BoardParts& parts) {
  return {parts.half_mm[0], parts.half_mm[1], from_block<BoardShape>(parts.shape.data())};
}

Vector3<double> to_core(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

plenocal::MicroPixel to_core(const MicroPixel& p) { return {p.k, p.l, {p.u_px, p.v_px}}; }

plenocal::Loss to_core(const Loss& loss) { return {loss.kind, loss.scale}; }

std::vector<Pose> poses_of(const ProblemParts& problem) {
  return mapped<std::vector>(problem.poses,
                             [](const PoseBlock& pose) { return pose_from_block(pose.block); });
}

Observations observations_of(const ProblemParts& problem) {
  const auto feature = [](const SolverFeature& f) -> FeatureObservation {
    const auto& [u, v, rho] = f.std_dev_px;
    return {to_core(f.pose), to_core(f.board_point_mm), f.k, f.l, {f.u_px, f.v_px, f.rho_px},
            {u, v, rho}};
  };
  const auto center = [](const SolverCenter& c) -> CenterObservation {
    return {c.k, c.l, {c.u_px, c.v_px}, c.std_dev_px};
  };
  return {mapped<std::vector>(problem.features, feature),
          mapped<std::vector>(problem.centers, center), to_core(problem.board)};
}

plenocal::SystematicError to_core(const SystematicError& shared) {
  plenocal::SystematicError error;
  for (auto by = shared.features_px.begin(); by != shared.features_px.end(); by += 3) {
    error.features.push_back({by[0], by[1], by[2]});
  }
  for (auto by = shared.centers_px.begin(); by != shared.centers_px.end(); by += 2) {
    error.centers.push_back({by[0], by[1]});
  }
  error.priors.assign(shared.priors.begin(), shared.priors.end());
  error.in_priors = shared.in_priors;
  return error;
}

plenocal::CostOptions to_core(const CostOptions& shared) {
  plenocal::CostOptions options;
  options.uv_std_dev = shared.uv_std_dev_px;
  options.rho_std_dev = shared.rho_std_dev_px;
  options.centers_std_dev = shared.centers_std_dev_px;
  options.rho = shared.rho;
  options.features_loss = options.centers_loss = to_core(shared.loss);
  options.fixed.clear();
  for (const rust::String& name : shared.fixed) options.fixed.emplace(name);
  for (const Prior& prior : shared.priors) {
    options.priors.push_back({std::string(prior.quantity), prior.value, prior.std_dev});
  }
  options.prior_weight = shared.prior_weight;
  return options;
}

template <typename Row, typename Value>
rust::Vec<Row> from_core(const std::vector<Value>& values) {
  return mapped<rust::Vec>(values, [](const Value& value) { return static_cast<Row>(value); });
}

rust::Vec<double> from_core(const std::vector<double>& values) { return from_core<double>(values); }

Matrix from_core(const plenocal::Matrix& m) {
  return {static_cast<std::size_t>(m.rows), static_cast<std::size_t>(m.columns),
          from_core(m.values)};
}

std::array<double, 3> from_core(const Vector3<double>& v) { return {v.x, v.y, v.z}; }

Ray from_core(const std::optional<plenocal::Ray<double>>& ray) {
  if (!ray) return {{kNan, kNan, kNan}, {kNan, kNan, kNan}};
  return {from_core(ray->origin), from_core(ray->direction)};
}

MetricPoint from_core(const std::optional<plenocal::MetricPoint>& point) {
  if (!point) return {{kNan, kNan, kNan}, {}, 0.0, 0};
  return {from_core(point->point), point->covariance, point->chi_square,
          static_cast<std::size_t>(point->freedom)};
}

Iteration from_core(const plenocal::Iteration& i) {
  return {i.number, i.cost, i.gradient_max_norm, i.step_norm, i.trust_region_radius, i.time_s};
}

}  // namespace

void silence_log() { FLAGS_minloglevel = google::GLOG_FATAL; }

rust::Vec<NamedParameter> parameters(const CameraParts& parts, const BoardParts& board) {
  const Camera camera = to_core(parts);
  const auto names = shared_names(camera.lens_types());
  rust::Vec<NamedParameter> rows;
  const auto add = [&](const std::string&, double value) {
    rows.push_back({names[rows.size()], value});
  };
  for_each_parameter(camera, add);
  const Board on_board = to_core(board);
  BoardShape<double>::visit(on_board.shape, add);
  return rows;
}

rust::Vec<NodeRow> lattice(const CameraParts& parts) {
  const Camera camera = to_core(parts);
  rust::Vec<NodeRow> rows;
  for (int l = 0; l < camera.lattice.rows; ++l) {
    for (int k = 0; k < camera.lattice.columns; ++k) {
      const auto [node, lens_type] = micro_lens_of(camera, k, l);
      rows.push_back({node.x, node.y, lens_type});
    }
  }
  return rows;
}

rust::Vec<Pair> distortion(const CameraParts& parts, rust::Slice<const Pair> points_mm) {
  const Camera camera = to_core(parts);
  validate(camera);
  // At the magnification of the plane that the main lens images onto the array.
  const double magnification = 1.0 - camera.mla.lens_to_mla / camera.main_lens.focal_length;
  return mapped<rust::Vec>(points_mm, [&](const Pair& point) -> Pair {
    const auto shift = plenocal::distortion(camera.main_lens, magnification, point.x, point.y);
    return {shift.x, shift.y};
  });
}

rust::Vec<Projected> project(const ProblemParts& problem) {
  const Camera camera = to_core(problem.camera);
  validate(camera);
  const Board board = to_core(problem.board);
  validate(board);
  const Optics<double> optics = optics_of(camera);
  const auto motions = mapped<std::vector>(
      problem.poses, [](const PoseBlock& pose) { return Motion<double>(pose.block.data()); });
  return mapped<rust::Vec>(problem.features, [&](const SolverFeature& f) -> Projected {
    const Vector3<double> corner = corner_of(board, to_core(f.board_point_mm));
    const auto feature =
        plenocal::project(optics, motions.at(f.pose)(corner), micro_lens_of(camera, f.k, f.l));
    if (!feature) return {kNan, kNan, kNan};
    return {feature->u, feature->v, feature->rho};
  });
}

rust::Vec<Pair> project_centers(const CameraParts& parts, rust::Slice<const MicroLensIndex> at) {
  const Camera camera = to_core(parts);
  validate(camera);
  return mapped<rust::Vec>(at, [&](const MicroLensIndex& index) -> Pair {
    const Pixel<double> pixel = project_center(camera, index.k, index.l);
    return {pixel.u, pixel.v};
  });
}

RefinementParts refine(const ProblemParts& problem, const CostOptions& cost,
                       const SolverOptions& solver, ProgressSink& progress) {
  plenocal::SolverOptions options;
  options.max_iterations = to_core(solver.max_iterations);
  options.threads = to_core(solver.threads);
  options.function_tolerance = solver.function_tolerance;
  options.initial_trust_region_radius = solver.initial_trust_region_radius;
  options.extrapolate = solver.extrapolate;
  const Refinement r = plenocal::refine(
      to_core(problem.camera), poses_of(problem), observations_of(problem), to_core(cost), options,
      [&progress](const plenocal::Iteration& i) { return progress.report(from_core(i)); });

  RefinementParts parts{};
  for_each_parameter(
      r.camera, [&parts](const std::string&, double value) { parts.parameters.push_back(value); });
  parts.shape = to_block(r.board_shape);
  for (const Pose& pose : r.poses) parts.poses.push_back({pose_block(pose)});
  parts.initial_cost = r.initial_cost;
  parts.cost = r.cost;
  parts.frame_costs = from_core(r.frame_costs);
  parts.termination = r.termination;
  parts.message = r.message;
  parts.report = r.report;
  parts.time_s = r.time_s;
  for (const auto& iteration : r.iterations) parts.iterations.push_back(from_core(iteration));
  return parts;
}

Uncertainty uncertainty(const ProblemParts& problem, const CostOptions& cost,
                        rust::Slice<const SystematicError> systematic, std::size_t threads) {
  const auto errors =
      mapped<std::vector>(systematic, [](const SystematicError& error) { return to_core(error); });
  const plenocal::Uncertainty u =
      plenocal::uncertainty(to_core(problem.camera), poses_of(problem), observations_of(problem),
                            to_core(cost), errors, to_core(threads));
  Uncertainty shared{};
  shared.free_intrinsics = from_core<std::size_t>(u.free_intrinsics);
  shared.rank = static_cast<std::size_t>(u.rank);
  shared.shared = u.shared;
  shared.covariance = from_core(u.covariance);
  shared.independent_covariance = from_core(u.independent_covariance);
  shared.noise_covariance = from_core(u.noise_covariance);
  shared.prior_covariance = from_core(u.prior_covariance);
  shared.freedom = from_core(u.freedom);
  shared.left_out_changes = from_core(u.left_out_changes);
  shared.frame_shares = from_core(u.frame_shares);
  for (int row = 0; row < u.systematic_changes.rows && u.systematic_changes.columns > 0; ++row) {
    SystematicChange change{systematic[row].source, {}};
    for (double by : u.systematic_changes.eigen().row(row)) change.changes.push_back(by);
    shared.systematic_changes.push_back(std::move(change));
  }
  shared.poses_by_intrinsics = from_core(u.poses_by_intrinsics);
  shared.dispersion = u.dispersion;
  shared.contradiction_std_devs = u.contradiction;
  shared.contradicted_row = u.contradicted;
  shared.information = from_core(u.information);
  shared.weakest = from_core(u.weakest);
  shared.determined = from_core<bool>(u.determined);
  shared.residual_std_dev_px = u.residual_std_dev;
  shared.std_dev_factors = u.std_dev_factors;
  shared.expected_decrease = u.expected_decrease;
  shared.next_step = from_core(u.next_step);
  shared.gradient = from_core(u.gradient);
  return shared;
}

rust::Vec<Matrix> frame_information(const ProblemParts& problem, const CostOptions& cost,
                                    std::size_t threads) {
  const auto of_frames =
      plenocal::frame_information(to_core(problem.camera), poses_of(problem),
                                  observations_of(problem), to_core(cost), to_core(threads));
  return mapped<rust::Vec>(of_frames, [](const plenocal::Matrix& m) { return from_core(m); });
}

rust::Vec<SolverFeature> visible_features(const CameraParts& parts, const BoardParts& board_parts,
                                          rust::Slice<const PoseBlock> poses,
                                          rust::Slice<const PointRow> board_points,
                                          double margin_px) {
  const Camera camera = to_core(parts);
  const Board board = to_core(board_parts);
  validate(board);
  const Optics<double> optics = optics_of(camera);
  rust::Vec<SolverFeature> rows;
  std::size_t frame = 0;
  for (const PoseBlock& pose : poses) {
    const Motion<double> camera_from_board(pose.block.data());
    for (const PointRow& row : board_points) {
      const Vector3<double> corner = corner_of(board, to_core(row.point_mm));
      const Vector3<double> point = camera_from_board(corner);
      for (const auto& [k, l] : micro_lenses_seeing(camera, point, margin_px)) {
        if (const auto seen = plenocal::project(optics, point, micro_lens_of(camera, k, l))) {
          rows.push_back({frame, row.point_mm, k, l, seen->u, seen->v, seen->rho, {1.0, 1.0, 1.0}});
        }
      }
    }
    ++frame;
  }
  return rows;
}

rust::Vec<PointSensitivity> point_sensitivities(const CameraParts& parts,
                                                rust::Slice<const PointRow> points,
                                                const std::array<double, 3>& std_dev_px,
                                                double margin_px) {
  const Camera camera = to_core(parts);
  const auto& [u, v, rho] = std_dev_px;
  const Feature<double> std_dev{u, v, rho};
  return mapped<rust::Vec>(points, [&](const PointRow& row) -> PointSensitivity {
    const auto s = point_sensitivity(camera, to_core(row.point_mm), std_dev, margin_px);
    return {static_cast<std::size_t>(s.micro_lenses), from_core(s.by_intrinsics), s.covariance};
  });
}

rust::Vec<MicroLensIndex> micro_images_at(const CameraParts& camera,
                                          rust::Slice<const Pair> pixels) {
  const BackProjection back(to_core(camera));
  return mapped<rust::Vec>(pixels, [&](const Pair& pixel) -> MicroLensIndex {
    const auto at = back.micro_image_at({pixel.x, pixel.y});
    if (!at) return {-1, -1};
    return {at->k, at->l};
  });
}

rust::Vec<Ray> object_rays(const CameraParts& camera, rust::Slice<const MicroPixel> pixels,
                           double z_mm) {
  const BackProjection back(to_core(camera));
  return mapped<rust::Vec>(pixels, [&](const MicroPixel& pixel) {
    return from_core(back.object_ray(to_core(pixel), z_mm));
  });
}

rust::Vec<Ray> pixel_rays(const CameraParts& camera, rust::Slice<const Pair> pixels, double z_mm) {
  const BackProjection back(to_core(camera));
  return mapped<rust::Vec>(pixels, [&](const Pair& pixel) {
    const auto at = back.micro_image_at({pixel.x, pixel.y});
    const auto ray = at ? back.object_ray({at->k, at->l, {pixel.x, pixel.y}}, z_mm) : std::nullopt;
    return from_core(ray);
  });
}

rust::Vec<MetricPoint> metric_points(const CameraParts& camera,
                                     rust::Slice<const VirtualPoint> seen, bool focused) {
  const BackProjection back(to_core(camera));
  return mapped<rust::Vec>(seen, [&](const VirtualPoint& s) {
    const plenocal::VirtualPoint point{to_core(s.at), s.virtual_depth, s.std_dev};
    return from_core(focused ? back.focused_point(point) : back.point(point));
  });
}

rust::Vec<double> virtual_depths(const CameraParts& camera, rust::Slice<const MicroPixel> at,
                                 rust::Slice<const PointRow> points) {
  const BackProjection back(to_core(camera));
  auto next = at.begin();
  return mapped<rust::Vec>(points, [&](const PointRow& row) {
    const MicroPixel& pixel = *next++;
    return back.virtual_depth(pixel.k, pixel.l, to_core(row.point_mm)).value_or(kNan);
  });
}

rust::Vec<MetricPoint> triangulate(const CameraParts& camera, rust::Slice<const SeenPoint> points,
                                   const Loss& loss) {
  const BackProjection back(to_core(camera));
  const auto sighting = [](const Sighting& s) -> plenocal::Sighting {
    const auto& [u, v, rho] = s.std_dev_px;
    return {s.at.k, s.at.l, {s.at.u_px, s.at.v_px, s.rho_px}, {u, v, rho}, s.correlation};
  };
  return mapped<rust::Vec>(points, [&](const SeenPoint& point) {
    return from_core(back.triangulate(mapped<std::vector>(point.sightings, sighting), to_core(loss),
                                      point.rho_std_dev_px));
  });
}

}  // namespace plenocal::bridge
