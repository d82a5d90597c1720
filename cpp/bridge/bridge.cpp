#include "bridge.hpp"

#include <glog/logging.h>

#include "plenocal/src/solver/bridge.rs.h"

namespace plenocal::bridge {
namespace {

Camera to_core(const CameraParts& parts) {
  Camera camera;
  camera.lattice = {parts.packing, parts.columns, parts.rows};
  camera.pixel_size = parts.pixel_size_mm;
  camera.micro_lens_focal_lengths.resize(parts.lens_types);
  auto next = parts.parameters.begin();
  for_each_parameter(camera, [&next](const std::string&, double& value) { value = *next++; });
  return camera;
}

CameraParts from_core(const Camera& camera) {
  CameraParts parts{};
  parts.packing = camera.lattice.packing;
  parts.columns = camera.lattice.columns;
  parts.rows = camera.lattice.rows;
  parts.pixel_size_mm = camera.pixel_size;
  parts.lens_types = camera.lens_types();
  for_each_parameter(
      camera, [&parts](const std::string&, double value) { parts.parameters.push_back(value); });
  return parts;
}

Board to_core(const BoardParts& parts) {
  return {parts.half_mm[0], parts.half_mm[1], from_block<BoardShape>(parts.shape.data())};
}

Vector3<double> to_core(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

std::vector<Pose> to_core(rust::Slice<const PoseBlock> blocks) {
  std::vector<Pose> poses;
  poses.reserve(blocks.size());
  for (const PoseBlock& b : blocks) poses.push_back(pose_from_block(b.block));
  return poses;
}

Observations to_core(const BoardParts& board, rust::Slice<const FeatureRow> features,
                     rust::Slice<const CenterRow> centers) {
  Observations observations;
  observations.board = to_core(board);
  observations.features.reserve(features.size());
  for (const FeatureRow& f : features) {
    observations.features.push_back({f.frame,
                                     to_core(f.board_point_mm),
                                     f.k,
                                     f.l,
                                     {f.u_px, f.v_px, f.rho_px},
                                     {f.std_dev_px[0], f.std_dev_px[1], f.std_dev_px[2]}});
  }
  observations.centers.reserve(centers.size());
  for (const CenterRow& c : centers) {
    observations.centers.push_back({c.k, c.l, {c.u_px, c.v_px}, c.std_dev_px});
  }
  return observations;
}

std::vector<CommonError> to_core(rust::Slice<const CommonErrorParts> parts) {
  std::vector<CommonError> errors;
  for (const CommonErrorParts& part : parts) {
    CommonError error;
    for (std::size_t i = 0; i + 2 < part.features_px.size(); i += 3) {
      const double* by = &part.features_px[i];
      error.features.push_back({by[0], by[1], by[2]});
    }
    for (std::size_t i = 0; i + 1 < part.centers_px.size(); i += 2) {
      error.centers.push_back({part.centers_px[i], part.centers_px[i + 1]});
    }
    error.anchors.assign(part.anchors.begin(), part.anchors.end());
    error.in_anchors = part.in_anchors;
    errors.push_back(std::move(error));
  }
  return errors;
}

CostOptions to_core(const CostParts& parts) {
  CostOptions options;
  options.uv_std_dev = parts.uv_std_dev_px;
  options.rho_std_dev = parts.rho_std_dev_px;
  options.centers_std_dev = parts.centers_std_dev_px;
  options.rho = parts.rho;
  options.features_loss = {parts.loss_kind, parts.loss_scale};
  options.centers_loss = options.features_loss;
  options.fixed.clear();
  for (const rust::String& name : parts.fixed) options.fixed.emplace(name);
  for (const AnchorRow& anchor : parts.anchors) {
    options.anchors.push_back({std::string(anchor.quantity), anchor.value, anchor.std_dev});
  }
  options.anchor_weight = parts.anchor_weight;
  return options;
}

rust::Vec<double> from_core(const std::vector<double>& values) {
  rust::Vec<double> result;
  result.reserve(values.size());
  for (double value : values) result.push_back(value);
  return result;
}

std::array<double, 3> from_core(const Vector3<double>& v) { return {v.x, v.y, v.z}; }

MetricRow from_core(const std::optional<MetricPoint>& point) {
  if (!point) return MetricRow{};
  return {true, from_core(point->point), point->covariance, point->chi_square, point->freedom};
}

IterationRow from_core(const Iteration& i) {
  return {i.number, i.cost, i.gradient_max_norm, i.step_norm, i.trust_region_radius, i.time_s};
}

}  // namespace

void silence_log() { FLAGS_minloglevel = google::GLOG_ERROR; }

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

rust::Vec<PairRow> distortion(const CameraParts& parts, rust::Slice<const PairRow> points_mm) {
  const Camera camera = to_core(parts);
  validate(camera);
  rust::Vec<PairRow> rows;
  rows.reserve(points_mm.size());
  for (const auto& [x, y] : points_mm) {
    const auto shift = plenocal::distortion(camera.main_lens, x, y);
    rows.push_back({shift.x, shift.y});
  }
  return rows;
}

rust::Vec<ProjectionRow> project(const CameraParts& parts, const BoardParts& board_parts,
                                 rust::Slice<const PoseBlock> pose_blocks,
                                 rust::Slice<const FeatureRow> features) {
  const Camera camera = to_core(parts);
  validate(camera);
  const Board board = to_core(board_parts);
  validate(board);
  const Optics<double> optics = optics_of(camera);
  std::vector<Motion<double>> motions;
  for (const PoseBlock& pose : pose_blocks) motions.emplace_back(pose.block.data());
  rust::Vec<ProjectionRow> rows;
  rows.reserve(features.size());
  for (const FeatureRow& f : features) {
    const Vector3<double> corner = corner_of(board, to_core(f.board_point_mm));
    const auto feature =
        plenocal::project(optics, motions.at(f.frame)(corner), micro_lens_of(camera, f.k, f.l));
    rows.push_back(feature ? ProjectionRow{true, feature->u, feature->v, feature->rho}
                           : ProjectionRow{});
  }
  return rows;
}

rust::Vec<PairRow> project_centers(const CameraParts& parts,
                                   rust::Slice<const MicroLensIndex> micro_lenses) {
  const Camera camera = to_core(parts);
  validate(camera);
  rust::Vec<PairRow> rows;
  rows.reserve(micro_lenses.size());
  for (const auto& [k, l] : micro_lenses) {
    const Pixel<double> pixel = project_center(camera, k, l);
    rows.push_back({pixel.u, pixel.v});
  }
  return rows;
}

RefinementParts refine(const CameraParts& camera, const BoardParts& board,
                       rust::Slice<const PoseBlock> poses, rust::Slice<const FeatureRow> features,
                       rust::Slice<const CenterRow> centers, const CostParts& cost,
                       const SolverParts& solver, ProgressSink& progress) {
  SolverOptions options;
  options.max_iterations = solver.max_iterations;
  options.threads = solver.threads;
  options.function_tolerance = solver.function_tolerance;
  options.initial_trust_region_radius = solver.initial_trust_region_radius;
  options.extrapolate = solver.extrapolate;
  const Refinement r = plenocal::refine(
      to_core(camera), to_core(poses), to_core(board, features, centers), to_core(cost), options,
      [&progress](const Iteration& i) { return progress.report(from_core(i)); });

  RefinementParts parts{};
  parts.camera = from_core(r.camera);
  parts.shape = to_block(r.board_shape);
  for (const Pose& pose : r.poses) parts.poses.push_back({pose_block(pose)});
  parts.initial_cost = r.initial_cost;
  parts.cost = r.cost;
  parts.frame_costs = from_core(r.frame_costs);
  parts.termination = r.termination;
  parts.message = r.message;
  parts.report = r.report;
  parts.time_s = r.time_s;
  for (const Iteration& i : r.iterations) parts.iterations.push_back(from_core(i));
  return parts;
}

UncertaintyParts uncertainty(const CameraParts& camera, const BoardParts& board,
                             rust::Slice<const PoseBlock> poses,
                             rust::Slice<const FeatureRow> features,
                             rust::Slice<const CenterRow> centers, const CostParts& cost,
                             rust::Slice<const CommonErrorParts> common, int32_t threads) {
  const Uncertainty u =
      plenocal::uncertainty(to_core(camera), to_core(poses), to_core(board, features, centers),
                            to_core(cost), to_core(common), threads);
  UncertaintyParts parts{};
  for (int index : u.free_intrinsics) parts.free_intrinsics.push_back(index);
  parts.size = u.size;
  parts.rank = u.rank;
  parts.shared = u.shared;
  parts.covariance = from_core(u.covariance.values);
  parts.independent_covariance = from_core(u.independent_covariance.values);
  parts.freedom = from_core(u.freedom);
  parts.left_out_changes = from_core(u.left_out_changes.values);
  parts.common_changes = from_core(u.common_changes.values);
  parts.frame_shares = from_core(u.frame_shares.values);
  parts.poses_by_intrinsics = from_core(u.poses_by_intrinsics.values);
  parts.dispersion = u.dispersion;
  parts.contradiction = u.contradiction;
  parts.contradicted = u.contradicted;
  parts.information = from_core(u.information);
  parts.weakest = from_core(u.weakest.values);
  for (bool value : u.determined) parts.determined.push_back(value);
  parts.residual_std_dev_px = u.residual_std_dev;
  parts.std_dev_factors = u.std_dev_factors;
  parts.expected_decrease = u.expected_decrease;
  parts.next_step = from_core(u.next_step);
  parts.gradient = from_core(u.gradient);
  return parts;
}

rust::Vec<double> frame_information(const CameraParts& camera, const BoardParts& board,
                                    rust::Slice<const PoseBlock> poses,
                                    rust::Slice<const FeatureRow> features, const CostParts& cost,
                                    int32_t threads) {
  rust::Vec<double> all;
  for (const Matrix& of_frame : plenocal::frame_information(
           to_core(camera), to_core(poses), to_core(board, features, {}), to_core(cost), threads)) {
    for (double value : of_frame.values) all.push_back(value);
  }
  return all;
}

rust::Vec<FeatureRow> visible_features(const CameraParts& parts, const BoardParts& board_parts,
                                       rust::Slice<const PoseBlock> poses,
                                       rust::Slice<const PointRow> board_points, double margin_px) {
  const Camera camera = to_core(parts);
  const Board board = to_core(board_parts);
  validate(board);
  const Optics<double> optics = optics_of(camera);
  rust::Vec<FeatureRow> rows;
  int frame = 0;
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

rust::Vec<SensitivityRow> point_sensitivities(const CameraParts& parts,
                                              rust::Slice<const PointRow> points,
                                              const std::array<double, 3>& std_dev_px,
                                              double margin_px) {
  const Camera camera = to_core(parts);
  rust::Vec<SensitivityRow> rows;
  for (const PointRow& row : points) {
    const PointSensitivity s = point_sensitivity(
        camera, to_core(row.point_mm), {std_dev_px[0], std_dev_px[1], std_dev_px[2]}, margin_px);
    rows.push_back({s.micro_lenses, from_core(s.by_intrinsics.values), s.covariance});
  }
  return rows;
}

rust::Vec<MicroLensIndex> micro_images_at(const CameraParts& camera,
                                          rust::Slice<const PairRow> pixels) {
  const BackProjection back(to_core(camera));
  rust::Vec<MicroLensIndex> rows;
  rows.reserve(pixels.size());
  for (const auto& [u, v] : pixels) {
    const auto at = back.micro_image_at({u, v});
    rows.push_back(at ? MicroLensIndex{at->k, at->l} : MicroLensIndex{-1, -1});
  }
  return rows;
}

rust::Vec<RayRow> object_rays(const CameraParts& camera, rust::Slice<const MicroPixelRow> pixels,
                              double z_mm) {
  const BackProjection back(to_core(camera));
  rust::Vec<RayRow> rows;
  rows.reserve(pixels.size());
  for (const MicroPixelRow& p : pixels) {
    RayRow row{};
    if (const auto ray = back.object_ray({p.k, p.l, {p.u_px, p.v_px}}, z_mm)) {
      row = {true, from_core(ray->origin), from_core(ray->direction)};
    }
    rows.push_back(row);
  }
  return rows;
}

rust::Vec<RayRow> pixel_rays(const CameraParts& camera, rust::Slice<const PairRow> pixels,
                             double z_mm) {
  const BackProjection back(to_core(camera));
  rust::Vec<RayRow> rows;
  rows.reserve(pixels.size());
  for (const auto& [u, v] : pixels) {
    RayRow row{};
    if (const auto at = back.micro_image_at({u, v})) {
      if (const auto ray = back.object_ray({at->k, at->l, {u, v}}, z_mm)) {
        row = {true, from_core(ray->origin), from_core(ray->direction)};
      }
    }
    rows.push_back(row);
  }
  return rows;
}

rust::Vec<MetricRow> metric_points(const CameraParts& camera, rust::Slice<const VirtualRow> seen,
                                   bool focused) {
  const BackProjection back(to_core(camera));
  rust::Vec<MetricRow> rows;
  rows.reserve(seen.size());
  for (const VirtualRow& s : seen) {
    const VirtualPoint point{{s.k, s.l, {s.u_px, s.v_px}}, s.virtual_depth, s.std_dev};
    rows.push_back(from_core(focused ? back.focused_point(point) : back.point(point)));
  }
  return rows;
}

rust::Vec<double> virtual_depths(const CameraParts& camera,
                                 rust::Slice<const MicroLensIndex> micro_lenses,
                                 rust::Slice<const PointRow> points) {
  const BackProjection back(to_core(camera));
  rust::Vec<double> depths;
  depths.reserve(points.size());
  auto next = micro_lenses.begin();
  for (const PointRow& point : points) {
    const auto& [k, l] = *next++;
    depths.push_back(back.virtual_depth(k, l, to_core(point.point_mm))
                         .value_or(std::numeric_limits<double>::quiet_NaN()));
  }
  return depths;
}

rust::Vec<MetricRow> triangulate(const CameraParts& camera, rust::Slice<const SightingRow> all,
                                 rust::Slice<const SeenRow> points, LossKind loss_kind,
                                 double loss_scale) {
  const BackProjection back(to_core(camera));
  rust::Vec<MetricRow> rows;
  rows.reserve(points.size());
  auto next = all.begin();
  for (const SeenRow& point : points) {
    std::vector<Sighting> sightings;
    for (std::size_t i = 0; i < point.sightings; ++i, ++next) {
      const auto& [u, v, rho] = next->std_dev_px;
      sightings.push_back({next->k,
                           next->l,
                           {next->u_px, next->v_px, next->rho_px},
                           {u, v, rho},
                           next->correlation});
    }
    rows.push_back(
        from_core(back.triangulate(sightings, {loss_kind, loss_scale}, point.rho_std_dev_px)));
  }
  return rows;
}

}  // namespace plenocal::bridge
