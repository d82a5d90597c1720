// A ceres::Problem built from the library's residuals for an exported problem: features, centres,
// priors and fixed parameters. Its minimum is that of plenocal::refine. It is a starting point for
// costs with other terms or other blocks.
//
//   feature_residuals PROBLEM OUT
#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <plenocal/io.hpp>
#include <plenocal/residuals.hpp>
#include <stdexcept>
#include <string>
#include <vector>

namespace {

using namespace plenocal;

// Residual of a prior on one parameter of a block.
struct ParameterPrior {
  int index;
  double value, weight;

  template <typename T>
  bool operator()(const T* const* blocks, T* residual) const {
    residual[0] = (blocks[0][index] - value) * weight;
    return true;
  }
};

// The parameter blocks, in the order of `intrinsic_names`, and the poses.
struct Blocks {
  std::array<double, kMainLensParameters> lens;
  std::array<double, kExitPupilParameters> pupil;
  std::array<double, kArrayParameters> array;
  std::vector<double> focal_lengths;
  std::vector<std::array<double, Pose::kSize>> poses;

  explicit Blocks(const ProblemFiles& files)
      : lens(to_block(files.start.camera.main_lens)),
        pupil(to_block(files.start.camera.exit_pupil)),
        array(to_block(files.start.camera.mla)),
        focal_lengths(files.start.camera.micro_lens_focal_lengths) {
    for (const Pose& pose : files.poses) poses.push_back(pose_block(pose));
  }

  struct Intrinsic {
    double* data;
    int size;
  };
  std::vector<Intrinsic> intrinsics() {
    return {{lens.data(), kMainLensParameters},
            {pupil.data(), kExitPupilParameters},
            {array.data(), kArrayParameters},
            {focal_lengths.data(), static_cast<int>(focal_lengths.size())}};
  }

  Camera camera(Camera camera) const {
    camera.main_lens = from_block<MainLens>(lens.data());
    camera.exit_pupil = from_block<ExitPupil>(pupil.data());
    camera.mla = from_block<MicroLensArray>(array.data());
    camera.micro_lens_focal_lengths = focal_lengths;
    return camera;
  }
};

// A residual block for each frame. I is the number of lens types, or 0 if rho does not count.
template <int I>
void add_features(const ProblemFiles& files, Blocks* blocks, ceres::Problem* problem) {
  const Camera& camera = files.start.camera;
  const CostOptions& options = files.options;
  std::vector<std::vector<WeightedFeature>> frames(files.poses.size());
  for (const FeatureObservation& seen : files.observations.features) {
    frames[seen.frame].push_back(
        {corner_of(files.observations.board, seen.board_point),
         micro_lens_of(camera, seen.k, seen.l),
         seen.observed,
         {1.0 / (seen.std_dev.u * options.uv_std_dev), 1.0 / (seen.std_dev.v * options.uv_std_dev),
          1.0 / (seen.std_dev.rho * options.rho_std_dev)}});
  }
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (frames[i].empty()) continue;
    std::vector<double*> of_block = {blocks->lens.data(), blocks->array.data()};
    if (I > 0) of_block.push_back(blocks->focal_lengths.data());
    of_block.push_back(blocks->poses[i].data());
    // The loss acts within: one of Ceres' would act on the whole block.
    auto cost = FeatureResiduals<I>::create(frames[i], camera.pixel_size, options.features_loss);
    problem->AddResidualBlock(cost.release(), nullptr, of_block);
  }
}

void add_centers(const ProblemFiles& files, Blocks* blocks, ceres::Problem* problem) {
  const Camera& camera = files.start.camera;
  std::vector<WeightedCenter> centers;
  for (const CenterObservation& seen : files.observations.centers) {
    centers.push_back({camera.lattice.node(seen.k, seen.l), seen.observed,
                       1.0 / (seen.std_dev * files.options.centers_std_dev)});
  }
  if (centers.empty()) return;
  auto cost = CenterResiduals::create(centers, camera.pixel_size, files.options.centers_loss);
  problem->AddResidualBlock(cost.release(), nullptr, blocks->lens.data(), blocks->pupil.data(),
                            blocks->array.data());
}

void add_prior(const Prior& prior, double weight, Blocks* blocks, ceres::Problem* problem) {
  double *lens = blocks->lens.data(), *pupil = blocks->pupil.data(), *array = blocks->array.data(),
         *focal_lengths = blocks->focal_lengths.data();
  if (prior.quantity == kSlopeName) {
    auto cost = SlopeResidual::create(prior.value, weight);
    problem->AddResidualBlock(cost.release(), nullptr, lens, pupil, array);
    return;
  }
  for (int axis = 0; axis < 2; ++axis) {
    if (prior.quantity != kTiltGradientNames[axis]) continue;
    auto cost = TiltGradientResidual::create(axis, prior.value, weight);
    problem->AddResidualBlock(cost.release(), nullptr, pupil, array);
    return;
  }
  const int types = static_cast<int>(blocks->focal_lengths.size());
  for (int type = 0; type < types; ++type) {
    if (prior.quantity != intercept_name(type)) continue;
    auto cost = types == 1 ? InterceptResidual<1>::create(type, prior.value, weight)
                           : InterceptResidual<3>::create(type, prior.value, weight);
    problem->AddResidualBlock(cost.release(), nullptr, array, focal_lengths);
    return;
  }
  const auto names = intrinsic_names(types);
  auto index =
      static_cast<int>(std::find(names.begin(), names.end(), prior.quantity) - names.begin());
  for (const auto& [data, size] : blocks->intrinsics()) {
    if (index < size) {
      auto* cost = new ceres::DynamicAutoDiffCostFunction<ParameterPrior>(
          new ParameterPrior{index, prior.value, weight});
      cost->AddParameterBlock(size);
      cost->SetNumResiduals(1);
      problem->AddResidualBlock(cost, nullptr, data);
      return;
    }
    index -= size;
  }
  throw std::runtime_error("problem.json: a prior of " + prior.quantity +
                           " is not for this camera");
}

void fix(const CostOptions& options, Blocks* blocks, ceres::Problem* problem) {
  const auto names = intrinsic_names(static_cast<int>(blocks->focal_lengths.size()));
  auto name = names.begin();
  for (const auto& [data, size] : blocks->intrinsics()) {
    std::vector<int> constant;
    for (int i = 0; i < size; ++i) {
      if (options.fixed.count(*name++) > 0) constant.push_back(i);
    }
    if (size == 0 || constant.empty() || !problem->HasParameterBlock(data)) continue;
    if (static_cast<int>(constant.size()) == size) {
      problem->SetParameterBlockConstant(data);
    } else {
      problem->SetManifold(data, new ceres::SubsetManifold(size, constant));
    }
  }
}

bool run(const std::string& folder, const std::string& out) {
  const ProblemFiles files = read_problem(folder);
  for (const Parameter* shape = kBoardShapeTable; shape != std::end(kParameters); ++shape) {
    if (files.options.fixed.count(shape->name) == 0) {
      throw std::runtime_error("problem.json: the shape of the board is free (--board flat)");
    }
  }
  Blocks blocks(files);
  ceres::Problem problem;
  switch (files.options.rho ? files.start.camera.lens_types() : 0) {
    case 0:
      add_features<0>(files, &blocks, &problem);
      break;
    case 1:
      add_features<1>(files, &blocks, &problem);
      break;
    default:
      add_features<3>(files, &blocks, &problem);
  }
  add_centers(files, &blocks, &problem);
  for (const Prior& prior : files.options.priors) {
    add_prior(prior, std::sqrt(files.options.prior_weight) / prior.std_dev, &blocks, &problem);
  }
  fix(files.options, &blocks, &problem);

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.max_num_iterations = 500;
  options.function_tolerance = 1e-13;
  options.parameter_tolerance = 1e-12;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  std::printf("%s\n", summary.BriefReport().c_str());

  CameraFile file = files.start;
  file.camera = blocks.camera(file.camera);
  file.converged = summary.termination_type == ceres::CONVERGENCE;
  std::map<int, Pose> poses;
  for (std::size_t i = 0; i < blocks.poses.size(); ++i) {
    poses[files.frames[i]] = pose_from_block(blocks.poses[i]);
  }
  std::filesystem::create_directories(out);
  write_camera(out + "/camera.json", file);
  write_poses(out + "/poses.json", poses);

  const Refinement refined =
      refine(files.start.camera, files.poses, files.observations, files.options, {});
  const double apart = summary.final_cost / refined.cost - 1.0;
  std::printf("cost %.9e, of plenocal::refine %.9e: apart by %.1e\n", summary.final_cost,
              refined.cost, apart);
  return std::abs(apart) < 1e-6;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return std::fprintf(stderr, "usage: feature_residuals PROBLEM OUT\n"), 2;
  try {
    return run(argv[1], argv[2]) ? 0 : 1;
  } catch (const std::exception& error) {
    return std::fprintf(stderr, "feature_residuals: %s\n", error.what()), 1;
  }
}
