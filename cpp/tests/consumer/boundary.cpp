// All that a program can ask of the library, with the size and place of every member of its
// structs, as text: the same whatever the program is compiled with. Memory of the one must never
// be freed by the other, and no function of the one may take the place of one of the other.
#include <Eigen/Dense>
#include <cmath>
#include <cstddef>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <plenocal/back_projection.hpp>
#include <plenocal/io.hpp>
#include <plenocal/points.hpp>
#include <plenocal/problem.hpp>
#include <plenocal/residuals.hpp>
#include <stdexcept>
#include <string>

namespace {

using namespace plenocal;

// Offsets in structs with defaults for members are what every compiler here supports.
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Winvalid-offsetof"
#endif

#define STRUCT(type) std::printf("%s %zu %zu\n", #type, sizeof(type), alignof(type))
#define MEMBER(type, member) std::printf("  %s %zu\n", #member, offsetof(type, member))

void print_layout() {
  STRUCT(Vector3<double>);
  STRUCT(Vector2<double>);
  STRUCT(Pixel<double>);
  STRUCT(Feature<double>);
  STRUCT(Pose);
  STRUCT(Node);
  STRUCT(Lattice);
  STRUCT(MainLens<double>);
  STRUCT(ExitPupil<double>);
  STRUCT(MicroLensArray<double>);
  STRUCT(MicroLens);
  STRUCT(ArrayOptics<double>);
  STRUCT(Optics<double>);
  STRUCT(Ray<double>);
  STRUCT(Motion<double>);
  STRUCT(BoardShape<double>);
  STRUCT(Loss);
  STRUCT(Camera);
  MEMBER(Camera, lattice);
  MEMBER(Camera, pixel_size);
  MEMBER(Camera, width);
  MEMBER(Camera, height);
  MEMBER(Camera, main_lens);
  MEMBER(Camera, exit_pupil);
  MEMBER(Camera, mla);
  MEMBER(Camera, micro_lens_focal_lengths);
  STRUCT(Board);
  MEMBER(Board, half_width);
  MEMBER(Board, half_height);
  MEMBER(Board, shape);
  STRUCT(Matrix);
  MEMBER(Matrix, rows);
  MEMBER(Matrix, columns);
  MEMBER(Matrix, values);
  STRUCT(MicroPixel);
  MEMBER(MicroPixel, pixel);
  STRUCT(MicroImage);
  MEMBER(MicroImage, center);
  MEMBER(MicroImage, distance);
  STRUCT(VirtualPoint);
  MEMBER(VirtualPoint, virtual_depth);
  MEMBER(VirtualPoint, std_dev);
  STRUCT(Sighting);
  MEMBER(Sighting, observed);
  MEMBER(Sighting, std_dev);
  MEMBER(Sighting, correlation);
  STRUCT(MetricPoint);
  MEMBER(MetricPoint, covariance);
  MEMBER(MetricPoint, chi_square);
  MEMBER(MetricPoint, freedom);
  STRUCT(BackProjection);
  STRUCT(MicroLensIndex);
  STRUCT(PointSensitivity);
  MEMBER(PointSensitivity, by_intrinsics);
  MEMBER(PointSensitivity, covariance);
  STRUCT(FeatureObservation);
  MEMBER(FeatureObservation, board_point);
  MEMBER(FeatureObservation, k);
  MEMBER(FeatureObservation, observed);
  MEMBER(FeatureObservation, std_dev);
  STRUCT(CenterObservation);
  MEMBER(CenterObservation, observed);
  MEMBER(CenterObservation, std_dev);
  STRUCT(Observations);
  MEMBER(Observations, centers);
  MEMBER(Observations, board);
  STRUCT(Prior);
  MEMBER(Prior, value);
  MEMBER(Prior, std_dev);
  STRUCT(CostOptions);
  MEMBER(CostOptions, rho);
  MEMBER(CostOptions, features_loss);
  MEMBER(CostOptions, centers_loss);
  MEMBER(CostOptions, fixed);
  MEMBER(CostOptions, fixed_poses);
  MEMBER(CostOptions, priors);
  MEMBER(CostOptions, prior_weight);
  STRUCT(SolverOptions);
  MEMBER(SolverOptions, threads);
  MEMBER(SolverOptions, extrapolate);
  STRUCT(Iteration);
  MEMBER(Iteration, time_s);
  STRUCT(Progress);
  STRUCT(Refinement);
  MEMBER(Refinement, board_shape);
  MEMBER(Refinement, poses);
  MEMBER(Refinement, cost);
  MEMBER(Refinement, frame_costs);
  MEMBER(Refinement, termination);
  MEMBER(Refinement, message);
  MEMBER(Refinement, report);
  MEMBER(Refinement, time_s);
  MEMBER(Refinement, iterations);
  STRUCT(Uncertainty);
  MEMBER(Uncertainty, free_intrinsics);
  MEMBER(Uncertainty, names);
  MEMBER(Uncertainty, size);
  MEMBER(Uncertainty, rank);
  MEMBER(Uncertainty, shared);
  MEMBER(Uncertainty, covariance);
  MEMBER(Uncertainty, independent_covariance);
  MEMBER(Uncertainty, noise_covariance);
  MEMBER(Uncertainty, prior_covariance);
  MEMBER(Uncertainty, freedom);
  MEMBER(Uncertainty, left_out_changes);
  MEMBER(Uncertainty, frame_shares);
  MEMBER(Uncertainty, poses_by_intrinsics);
  MEMBER(Uncertainty, dispersion);
  MEMBER(Uncertainty, contradiction);
  MEMBER(Uncertainty, contradicted);
  MEMBER(Uncertainty, information);
  MEMBER(Uncertainty, weakest);
  MEMBER(Uncertainty, determined);
  MEMBER(Uncertainty, residual_std_dev);
  MEMBER(Uncertainty, std_dev_factors);
  MEMBER(Uncertainty, systematic_changes);
  MEMBER(Uncertainty, expected_decrease);
  MEMBER(Uncertainty, next_step);
  MEMBER(Uncertainty, gradient);
  STRUCT(SystematicError);
  MEMBER(SystematicError, centers);
  MEMBER(SystematicError, priors);
  MEMBER(SystematicError, in_priors);
  STRUCT(Evaluation);
  MEMBER(Evaluation, residuals);
  MEMBER(Evaluation, gradient);
  MEMBER(Evaluation, jacobian);
  STRUCT(CalibrationProblem);
  STRUCT(CalibrationProblem::Blocks);
  MEMBER(CalibrationProblem::Blocks, poses);
  STRUCT(WeightedFeature);
  STRUCT(WeightedCenter);
  STRUCT(FileError);
  STRUCT(CameraFile);
  MEMBER(CameraFile, f_number);
  MEMBER(CameraFile, focus_distance);
  MEMBER(CameraFile, converged);
  MEMBER(CameraFile, verdict);
  MEMBER(CameraFile, reasons);
  MEMBER(CameraFile, undetermined);
  MEMBER(CameraFile, std_dev);
  MEMBER(CameraFile, covariance);
  STRUCT(BoardGrid);
  STRUCT(ObservationFiles);
  MEMBER(ObservationFiles, frames);
  MEMBER(ObservationFiles, corners);
  STRUCT(ProblemFiles);
  MEMBER(ProblemFiles, frames);
  MEMBER(ProblemFiles, poses);
  MEMBER(ProblemFiles, observations);
  MEMBER(ProblemFiles, options);
}

// Other instructions round differently: six digits of a value, unless it is nothing but rounding.
void print(const char* what, double value) {
  std::printf("%s %.6g\n", what, std::abs(value) < 1e-9 ? 0.0 : value);
}

void require(bool holds, const char* what) {
  if (!holds) throw std::runtime_error(what);
}

Camera make_camera() {
  Camera camera;
  camera.lattice = {Packing::kHexagonalRowsEven, 20, 20};
  camera.pixel_size = 0.0055;
  camera.width = 500;
  camera.height = 480;
  camera.main_lens.focal_length = 50.0;
  camera.mla = {{250.0, 240.0}, 0.33, {}, {}, 59.0, 0.13, 1.0};
  camera.micro_lens_focal_lengths = {0.58, 0.5, 0.55};
  return camera;
}

Observations observe(const Camera& camera, const std::vector<Pose>& poses) {
  Observations seen;
  for (std::size_t frame = 0; frame < poses.size(); ++frame) {
    for (int i = 0; i < 20; ++i) {
      const Vector3<double> corner{2.0 * (i % 5), 2.0 * (i / 5), 0.0};
      const auto point = transformed(poses[frame], corner);
      for (const auto& [k, l] : micro_lenses_seeing(camera, point, 1.0)) {
        const auto feature = project(camera, poses[frame], corner, k, l);
        if (feature) seen.features.push_back({static_cast<int>(frame), corner, k, l, *feature});
      }
    }
  }
  for (int l = 0; l < camera.lattice.rows; ++l) {
    for (int k = 0; k < camera.lattice.columns; ++k) {
      seen.centers.push_back({k, l, project_center(camera, k, l)});
    }
  }
  return seen;
}

// Projection, its derivatives, and the way back.
void use_one_point(const Camera& camera) {
  const Pose pose{{0.1, -0.2, 0.3}, {1.0, -2.0, 300.0}};
  const Vector3<double> corner{1.0, 2.0, 0.0}, point = transformed(pose, corner);
  print("round trip", transformed(inverse(pose), point).x);
  print("composed", composed(pose, pose).rotation.z);
  const BackProjection back(camera);
  std::vector<Sighting> sightings;
  for (const auto& [k, l] : micro_lenses_seeing(camera, point, 1.0)) {
    const auto seen = project(camera, pose, corner, k, l);
    require(seen.has_value(), "a point that is seen is projected");
    sightings.push_back({k, l, *seen, {0.1, 0.1, 0.1}});
  }
  const Sighting& one = sightings.at(0);
  // Twenty derivatives are as many as a cost of the library has, and aligned as the flags say.
  using Jet = ceres::Jet<double, 20>;
  const Optics<Jet> optics(cast<Jet>(camera.main_lens), cast<Jet>(camera.mla), nullptr, 0,
                           camera.pixel_size);
  const auto jet = plenocal::project(optics, {Jet(point.x, 0), Jet(point.y, 1), Jet(point.z, 2)},
                                     micro_lens_of(camera, one.k, one.l));
  require(jet.has_value(), "a point that is seen has derivatives");
  print("du/dx", jet->u.v[0]);
  const MicroPixel pixel{one.k, one.l, {one.observed.u, one.observed.v}};
  print("micro-image", back.micro_image_at(pixel.pixel).value().distance);
  print("radius", back.micro_image_radius());
  print("ray behind", back.ray_behind(pixel, {0.5, 0.0}).value().direction.x);
  print("object ray", back.object_ray(pixel, 300.0).value().direction.y);
  const double depth = back.virtual_depth(one.k, one.l, point).value();
  print("depth", depth);
  print("depth of blur", back.virtual_depth_of_blur(one.k, one.l, one.observed.rho).value());
  const VirtualPoint seen{pixel, depth, {0.1, 0.1, 0.01}};
  print("point", back.point(seen).value().covariance[8]);
  print("focused point", back.focused_point(seen).value().point.z);
  const MetricPoint found = back.triangulate(sightings, {LossKind::kHuber, 3.0}, 0.01).value();
  print("triangulated", found.point.z);
  print("its covariance", found.covariance[0]);
  std::vector<Ray<double>> rays(2);
  print("rays", back.object_rays(&pixel.pixel, 1, 300.0, rays.data()));
  MetricPoint many;
  print("points", back.points(&seen, 1, &many));
  const PointSensitivity response = point_sensitivity(camera, point, {0.1, 0.1, 0.1}, 1.0);
  const Eigen::MatrixXd by_intrinsics = response.by_intrinsics.eigen();
  print("sensitivity", by_intrinsics.col(0).norm());
}

// An own ceres::Problem of the library's functors. The gradient is that of all of them.
void use_functors(const Camera& camera, const std::vector<Pose>& poses, const Observations& seen) {
  auto lens = to_block(camera.main_lens);
  auto pupil = to_block(camera.exit_pupil);
  auto array = to_block(camera.mla);
  std::vector<double> focal_lengths = camera.micro_lens_focal_lengths;
  std::array<double, Pose::kSize> rig{}, pose = pose_block(poses[0]);
  std::vector<WeightedFeature> features;
  for (const FeatureObservation& o : seen.features) {
    if (o.frame != 0) continue;
    features.push_back({o.board_point, micro_lens_of(camera, o.k, o.l), o.observed, {1, 1, 1}});
  }
  std::vector<WeightedCenter> centers;
  for (const CenterObservation& o : seen.centers) {
    centers.push_back({camera.lattice.node(o.k, o.l), o.observed, 1.0});
  }
  const double s = camera.pixel_size;
  lens[0] *= 1.001;
  ceres::Problem problem;
  problem.AddResidualBlock(FeatureResiduals<3>::create(features, s, {}).release(), nullptr,
                           lens.data(), array.data(), focal_lengths.data(), pose.data());
  problem.AddResidualBlock(FeatureResiduals<3, false, true>::create(features, s, {}).release(),
                           nullptr, lens.data(), array.data(), focal_lengths.data(), rig.data(),
                           pose.data());
  problem.AddResidualBlock(CenterResiduals::create(centers, s, {}).release(), nullptr, lens.data(),
                           pupil.data(), array.data());
  problem.AddResidualBlock(SlopeResidual::create(0.2, 10.0).release(), nullptr, lens.data(),
                           pupil.data(), array.data());
  problem.AddResidualBlock(InterceptResidual<3>::create(1, 0.04, 10.0).release(), nullptr,
                           array.data(), focal_lengths.data());
  problem.AddResidualBlock(TiltGradientResidual::create(0, 0.01, 10.0).release(), nullptr,
                           pupil.data(), array.data());
  double cost = 0.0;
  std::vector<double> gradient;
  require(problem.Evaluate({}, &cost, nullptr, &gradient, nullptr), "functors can be evaluated");
  print("cost of functors", cost);
  print("gradient of functors", Eigen::Map<Eigen::VectorXd>(gradient.data(), 8).norm());
}

void use_problem(const Camera& start, const std::vector<Pose>& poses, const Observations& seen) {
  CalibrationProblem problem(start, poses, seen, {});
  const Evaluation at = problem.evaluate();
  const Eigen::VectorXd own =
      Eigen::Map<const Eigen::VectorXd>(at.residuals.data(), at.residuals.size());
  require(std::abs(0.5 * own.squaredNorm() - at.cost) <= 1e-9 * at.cost, "the cost of residuals");
  Eigen::VectorXd state = Eigen::VectorXd::Zero(1);
  const std::vector<double> present = problem.state();
  state.resize(present.size());
  state = Eigen::Map<const Eigen::VectorXd>(present.data(), present.size());
  problem.set_state({state.begin(), state.end()});
  print("cost", at.cost);
  print("gradient", at.gradient.at(0));
  print("entries", at.jacobian.values.size());
  print("frame", problem.frame_costs().at(0));
  print("blocks", problem.free_blocks().size());
  print("names", problem.names().size());
  print("sag", problem.board_shape().sag_x);
  Observations of_second = seen;
  CalibrationProblem second(problem, {{0.0, 0.01, 0.0}, {1.0, 0.0, 0.0}}, start, of_second, {});
  double cost = 0.0;
  require(problem.problem().Evaluate({}, &cost, nullptr, nullptr, nullptr), "a rig has a cost");
  print("cost of a rig", cost);
  print("second camera", second.camera_from_first().translation.x);
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = problem.ordering();
  options.max_num_iterations = 2;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem.problem(), &summary);
  require(summary.final_cost < summary.initial_cost, "a rig is refined");
  require(problem.camera().main_lens.focal_length > 0.0, "the camera of a rig");
  require(problem.poses().size() == poses.size(), "the poses of a rig");
  CalibrationProblem other(start, poses, seen, {});
  ceres::Solve({}, other.compressed().get(), &summary);
  require(summary.final_cost < 1e-6 * at.cost, "few rows have the same minimum");
}

void use_refine(const Camera& start, const std::vector<Pose>& poses, const Observations& seen) {
  CostOptions options;
  options.fix({"Q3"});
  options.free({"dC_ratio"});
  options.priors.push_back({"F", 50.0, 0.1});
  int iterations = 0;
  const Refinement refined = refine(start, poses, seen, options, {}, [&](const Iteration& i) {
    ++iterations;
    return i.cost >= 0.0;
  });
  require(iterations > 0 && refined.iterations.size() > 0, "progress is told");
  print("F", refined.camera.main_lens.focal_length);
  SystematicError error;
  error.features.assign(seen.features.size(), {0.01, 0.0, 0.01});
  const Uncertainty u =
      uncertainty(refined.camera, refined.poses, seen, options, {error}, /*threads=*/2);
  print("parameters", u.size);
  print("rank", u.rank);
  require(u.std_dev_of("F") >= 0.0, "sigma of F");
  print("systematic", u.systematic_changes(0, 0));
  print("frames", frame_information(refined.camera, refined.poses, seen, options).size());
  // Products, inverses and changes of size: functions that the library has as well.
  Eigen::MatrixXd information = frame_information(start, poses, seen, options)[0].eigen();
  const int free = static_cast<int>(u.free_intrinsics.size());
  require(information.rows() == free, "the size of the information");
  information.diagonal().array() += 1e-6 * information.diagonal().maxCoeff();
  information.conservativeResize(free - 1, free - 1);
  const Eigen::VectorXd scale = information.diagonal().cwiseSqrt().cwiseInverse();
  const Eigen::MatrixXd scaled = scale.asDiagonal() * information * scale.asDiagonal();
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(scaled);
  print("largest eigenvalue", eigen.eigenvalues().maxCoeff());
  print("trace", (scaled * scaled.inverse()).trace());
}

void use_files(const std::string& folder, const Camera& camera, const std::vector<Pose>& poses,
               const Observations& seen) {
  CameraFile file;
  file.camera = camera;
  file.f_number = 4.0;
  file.verdict = Verdict::kDoNotUse;
  file.reasons = {"bad-fit"};
  file.std_dev.assign(intrinsic_names(camera.lens_types()).size(), 0.5);
  write_camera(folder + "/camera.json", file);
  print("sigma read", read_camera(folder + "/camera.json").std_dev.at(3));
  std::printf("%s\n", read_camera(folder + "/camera.json").objections().at(0).c_str());
  std::map<int, Pose> by_frame;
  for (std::size_t i = 0; i < poses.size(); ++i) by_frame[static_cast<int>(i)] = poses[i];
  write_poses(folder + "/poses.json", by_frame);
  print("poses read", read_poses(folder + "/poses.json").size());
  std::ofstream features(folder + "/features.csv");
  features << "frame,cluster,x,y,z,k,l,u,v,rho\n";
  for (const FeatureObservation& o : seen.features) {
    features << o.frame << ",0," << o.board_point.x << "," << o.board_point.y << ",0," << o.k << ","
             << o.l << "," << o.observed.u << "," << o.observed.v << "," << o.observed.rho << "\n";
  }
  features.close();
  std::ofstream(folder + "/centers.csv") << "k,l,u,v\n2,3,100,80\n";
  std::ofstream(folder + "/problem.json")
      << R"({"format": "plenocal-problem", "version": 1, "board": {"half_width_mm": 4,
             "half_height_mm": 3, "sag_x_mm": 0, "sag_y_mm": 0, "twist_mm": 0, "aspect": 0},
             "rho": true, "loss": {"kind": "none", "scale": 1}, "prior_weight": 1,
             "fixed": ["Q3"], "priors": [{"quantity": "F", "value": 50, "std_dev": 1}]})";
  const ProblemFiles problem = read_problem(folder);
  require(problem.observations.features.size() == seen.features.size(), "features are read");
  print("with frames", problem.with_frames({1}).centers.size());
  const ObservationFiles read =
      read_observations(folder + "/features.csv", folder + "/centers.csv", {5, 4, 2.0});
  print("frames read", read.frames.size());
  try {
    read_camera(folder + "/none.json");
  } catch (const FileError&) {
    std::printf("errors are caught\n");
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) return 2;
  try {
    print_layout();
    const Camera truth = make_camera();
    validate(truth);
    validate(Board{});
    std::vector<Pose> poses;
    for (double tilt : {-0.4, -0.2, 0.0, 0.2, 0.4, 0.5}) {
      poses.push_back({{tilt, 0.5 - tilt, 0.1}, {-4.0, -3.0, 265.0 + 60.0 * tilt}});
    }
    const Observations seen = observe(truth, poses);
    print("features", seen.features.size());
    Camera start = truth;
    start.main_lens.focal_length *= 1.002;
    use_one_point(truth);
    use_functors(truth, poses, seen);
    use_problem(start, poses, seen);
    use_refine(start, poses, seen);
    std::filesystem::create_directories(argv[1]);
    use_files(argv[1], truth, poses, seen);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "boundary: %s\n", error.what());
    return 1;
  }
  return 0;
}
