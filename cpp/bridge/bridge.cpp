#include "bridge.hpp"

#include <glog/logging.h>

#include "plenocal/refine.hpp"
#include "plenocal/src/solver/bridge.rs.h"

namespace plenocal::bridge {
namespace {

Camera to_core(const CameraParts& parts) {
  Camera camera;
  camera.lattice = {static_cast<LatticeKind>(parts.lattice_kind), parts.columns, parts.rows,
                    parts.shifted_parity};
  camera.pixel_size = parts.pixel_size_mm;
  camera.main_lens = MainLens<double>::from_block(parts.main_lens.data());
  camera.mla = MicroLensArray<double>::from_block(parts.array.data());
  camera.micro_lens_focal_lengths.assign(parts.focal_lengths_mm.begin(),
                                         parts.focal_lengths_mm.end());
  return camera;
}

CameraParts from_core(const Camera& camera) {
  CameraParts parts{};
  parts.lattice_kind = static_cast<int>(camera.lattice.kind);
  parts.columns = camera.lattice.columns;
  parts.rows = camera.lattice.rows;
  parts.shifted_parity = camera.lattice.shifted_parity;
  parts.pixel_size_mm = camera.pixel_size;
  parts.main_lens = camera.main_lens.block();
  parts.array = camera.mla.block();
  for (double f : camera.micro_lens_focal_lengths) parts.focal_lengths_mm.push_back(f);
  return parts;
}

std::vector<Pose> to_core(rust::Slice<const PoseBlock> blocks) {
  std::vector<Pose> poses;
  poses.reserve(blocks.size());
  for (const PoseBlock& b : blocks) poses.push_back(pose_from_block(b.block));
  return poses;
}

Observations to_core(rust::Slice<const FeatureRow> features, rust::Slice<const CenterRow> centers) {
  Observations observations;
  observations.features.reserve(features.size());
  for (const FeatureRow& f : features) {
    observations.features.push_back({f.frame,
                                     f.board_point_mm,
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

CostOptions to_core(const CostParts& parts) {
  CostOptions options;
  options.uv_std_dev = parts.uv_std_dev_px;
  options.rho_std_dev = parts.rho_std_dev_px;
  options.centers_std_dev = parts.centers_std_dev_px;
  options.features_loss = {static_cast<LossKind>(parts.loss_kind), parts.loss_scale};
  options.centers_loss = options.features_loss;
  options.held.clear();
  for (const rust::String& name : parts.held) options.held.push_back(std::string(name));
  return options;
}

IterationRow from_core(const Iteration& i) {
  return {i.number, i.cost, i.gradient_max_norm, i.step_norm, i.trust_region_radius, i.time_s};
}

}  // namespace

void silence_log() { FLAGS_minloglevel = google::GLOG_ERROR; }

rust::Vec<rust::String> intrinsic_names(int lens_types) {
  rust::Vec<rust::String> names;
  for (const std::string& name : plenocal::intrinsic_names(lens_types)) names.push_back(name);
  return names;
}

rust::Vec<Projection> lattice(const CameraParts& parts) {
  const Camera camera = to_core(parts);
  rust::Vec<Projection> nodes;
  for (int l = 0; l < camera.lattice.rows; ++l) {
    for (int k = 0; k < camera.lattice.columns; ++k) {
      const Node node = camera.lattice.node(k, l);
      nodes.push_back({camera.lattice.lens_type(k, l, camera.lens_types()), node.x, node.y, 0.0});
    }
  }
  return nodes;
}

rust::Vec<Projection> project(const CameraParts& parts, rust::Slice<const PoseBlock> pose_blocks,
                              rust::Slice<const FeatureRow> features) {
  const Camera camera = to_core(parts);
  validate(camera);
  const std::vector<Pose> poses = to_core(pose_blocks);
  rust::Vec<Projection> rows;
  rows.reserve(features.size());
  for (const FeatureRow& f : features) {
    Feature<double> feature{};
    const bool defined =
        plenocal::project(camera, poses.at(f.frame), f.board_point_mm, f.k, f.l, &feature);
    const int type = defined ? camera.lattice.lens_type(f.k, f.l, camera.lens_types()) : -1;
    rows.push_back({type, feature.u, feature.v, feature.rho});
  }
  return rows;
}

rust::Vec<Projection> project_centers(const CameraParts& parts,
                                      rust::Slice<const MicroLensIndex> micro_lenses) {
  const Camera camera = to_core(parts);
  validate(camera);
  rust::Vec<Projection> rows;
  rows.reserve(micro_lenses.size());
  for (const MicroLensIndex& c : micro_lenses) {
    const Pixel<double> pixel = project_center(camera, c.k, c.l);
    rows.push_back(
        {camera.lattice.lens_type(c.k, c.l, camera.lens_types()), pixel.u, pixel.v, 0.0});
  }
  return rows;
}

RefinementParts refine(const CameraParts& camera, rust::Slice<const PoseBlock> poses,
                       rust::Slice<const FeatureRow> features, rust::Slice<const CenterRow> centers,
                       const CostParts& cost, const SolverParts& solver, ProgressSink& progress) {
  SolverOptions options;
  options.max_iterations = solver.max_iterations;
  options.threads = solver.threads;
  options.initial_trust_region_radius = solver.initial_trust_region_radius;
  options.extrapolate = solver.extrapolate;
  const Refinement r = plenocal::refine(
      to_core(camera), to_core(poses), to_core(features, centers), to_core(cost), options,
      [&progress](const Iteration& i) { return progress.report(from_core(i)); });

  RefinementParts parts{};
  parts.camera = from_core(r.camera);
  for (const Pose& pose : r.poses) parts.poses.push_back({pose_block(pose)});
  parts.initial_cost = r.initial_cost;
  parts.cost = r.cost;
  for (double cost : r.frame_costs) parts.frame_costs.push_back(cost);
  parts.termination = static_cast<int>(r.termination);
  parts.message = r.message;
  parts.report = r.report;
  parts.time_s = r.time_s;
  for (const Iteration& i : r.iterations) parts.iterations.push_back(from_core(i));
  return parts;
}

UncertaintyParts uncertainty(const CameraParts& camera, rust::Slice<const PoseBlock> poses,
                             rust::Slice<const FeatureRow> features,
                             rust::Slice<const CenterRow> centers, const CostParts& cost) {
  const Uncertainty u = plenocal::uncertainty(to_core(camera), to_core(poses),
                                              to_core(features, centers), to_core(cost));
  UncertaintyParts parts{};
  for (int index : u.free_intrinsics) parts.free_intrinsics.push_back(index);
  parts.size = u.size;
  parts.rank = u.rank;
  parts.covariance.reserve(u.covariance.size());
  for (double value : u.covariance) parts.covariance.push_back(value);
  for (double value : u.information) parts.information.push_back(value);
  for (double value : u.weakest) parts.weakest.push_back(value);
  for (bool value : u.determined) parts.determined.push_back(value);
  parts.residual_std_dev_px = u.residual_std_dev;
  parts.expected_decrease = u.expected_decrease;
  return parts;
}

}  // namespace plenocal::bridge
