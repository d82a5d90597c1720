// Input for which the model is not defined: std::invalid_argument that names the culprit, never an
// abort.
#include <gtest/gtest.h>

#include <functional>
#include <limits>

#include "rejection.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using test::expect_names;
using test::rejection;
using test::Scene;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

// One way to spoil a valid scene or its options, and what the message has to contain.
struct Spoiled {
  const char* name;
  std::function<void(Scene*, CostOptions*)> spoil;
  const char* culprit;
};

std::ostream& operator<<(std::ostream& out, const Spoiled& spoiled) { return out << spoiled.name; }

std::string test_name(const testing::TestParamInfo<Spoiled>& info) { return info.param.name; }

Scene small_scene(int types) {
  Scene scene = test::make_scene(types);
  scene.poses.resize(2);
  scene.observations = test::observe(scene.camera, scene.poses);
  return scene;
}

class InvalidInput : public testing::TestWithParam<Spoiled> {};

TEST_P(InvalidInput, IsRejectedByRefine) {
  Scene scene = small_scene(3);
  CostOptions options;
  GetParam().spoil(&scene, &options);
  expect_names(
      rejection([&] { refine(scene.camera, scene.poses, scene.observations, options, {}); }),
      GetParam().culprit);
}

TEST_P(InvalidInput, IsRejectedByUncertainty) {
  Scene scene = small_scene(3);
  CostOptions options;
  GetParam().spoil(&scene, &options);
  expect_names(
      rejection([&] { uncertainty(scene.camera, scene.poses, scene.observations, options); }),
      GetParam().culprit);
}

// Spoilt values of the camera, rejected by validate() too.
class InvalidCamera : public InvalidInput {};

TEST_P(InvalidCamera, IsRejectedByValidate) {
  Scene scene = small_scene(3);
  CostOptions options;
  GetParam().spoil(&scene, &options);
  expect_names(rejection([&] { validate(scene.camera); }), GetParam().culprit);
}
TEST_P(InvalidCamera, IsRejectedByRefine) {
  Scene scene = small_scene(3);
  CostOptions options;
  GetParam().spoil(&scene, &options);
  expect_names(
      rejection([&] { refine(scene.camera, scene.poses, scene.observations, options, {}); }),
      GetParam().culprit);
}

INSTANTIATE_TEST_SUITE_P(
    Observations, InvalidInput,
    testing::Values(
        Spoiled{"NoFrames",
                [](Scene* s, CostOptions*) {
                  s->poses.clear();
                  s->observations.features.clear();
                },
                "no frames"},
        Spoiled{"FeatureU",
                [](Scene* s, CostOptions*) {
                  s->observations.features[0] = {1, {0, 0, 0}, 3, 4, {kNan, 2, 3}, {1, 1, 1}};
                },
                "feature of micro-lens (3, 4) in frame 1"},
        Spoiled{"FeatureV",
                [](Scene* s, CostOptions*) {
                  s->observations.features[0] = {0, {0, 0, 0}, 5, 6, {1, kInfinity, 3}, {1, 1, 1}};
                },
                "feature of micro-lens (5, 6) in frame 0"},
        Spoiled{"FeatureRho",
                [](Scene* s, CostOptions*) {
                  s->observations.features[0] = {0, {0, 0, 0}, 7, 8, {1, 2, kNan}, {1, 1, 1}};
                },
                "feature of micro-lens (7, 8) in frame 0"},
        Spoiled{"FeatureStdDevU",
                [](Scene* s, CostOptions*) {
                  s->observations.features[0] = {1, {0, 0, 0}, 3, 4, {1, 2, 3}, {0, 1, 1}};
                },
                "standard deviation of the feature of micro-lens (3, 4) in frame 1"},
        Spoiled{"FeatureStdDevV",
                [](Scene* s, CostOptions*) {
                  s->observations.features[0] = {1, {0, 0, 0}, 5, 6, {1, 2, 3}, {1, -1, 1}};
                },
                "standard deviation of the feature of micro-lens (5, 6) in frame 1"},
        Spoiled{"FeatureStdDevRho",
                [](Scene* s, CostOptions*) {
                  s->observations.features[0] = {0, {0, 0, 0}, 7, 8, {1, 2, 3}, {1, 1, kInfinity}};
                },
                "standard deviation of the feature of micro-lens (7, 8) in frame 0"},
        Spoiled{"CenterStdDev",
                [](Scene* s, CostOptions*) {
                  s->observations.centers[0] = {9, 8, {1, 2}, kNan};
                },
                "standard deviation of the centre of micro-lens (9, 8)"},
        Spoiled{"BoardPoint",
                [](Scene* s, CostOptions*) { s->observations.features[0].board_point.z = kNan; },
                "board point"},
        Spoiled{"Center",
                [](Scene* s, CostOptions*) {
                  s->observations.centers[0] = {9, 8, {1, kNan}, 1.0};
                },
                "centre of micro-lens (9, 8)"},
        Spoiled{"FeatureColumnBeyond",
                [](Scene* s, CostOptions*) { s->observations.features[0].k = 20; },
                "outside the array of 20 x 18"},
        Spoiled{"FeatureRowBeyond",
                [](Scene* s, CostOptions*) { s->observations.features[0].l = 18; },
                ", 18) is outside"},
        Spoiled{"FeatureColumnNegative",
                [](Scene* s, CostOptions*) { s->observations.features[0].k = -1; },
                "micro-lens (-1, "},
        Spoiled{"CenterRowNegative",
                [](Scene* s, CostOptions*) { s->observations.centers[0].l = -7; }, ", -7)"},
        Spoiled{"CenterColumnBeyond",
                [](Scene* s, CostOptions*) { s->observations.centers[0].k = 1000; },
                "micro-lens (1000, "},
        Spoiled{"FrameWithoutPose",
                [](Scene* s, CostOptions*) { s->observations.features[0].frame = 2; },
                "frame 2, which has no pose"},
        Spoiled{"FrameNegative",
                [](Scene* s, CostOptions*) { s->observations.features[0].frame = -1; },
                "frame -1, which has no pose"},
        Spoiled{"PoseWithoutFeature",
                [](Scene* s, CostOptions*) { s->poses.push_back(s->poses[0]); },
                "pose 2 has no feature"},
        Spoiled{"PoseRotation", [](Scene* s, CostOptions*) { s->poses[1].rotation.x = kNan; },
                "pose 1 is not finite"},
        Spoiled{"PoseTranslation",
                [](Scene* s, CostOptions*) { s->poses[0].translation.z = kInfinity; },
                "pose 0 is not finite"}),
    test_name);

INSTANTIATE_TEST_SUITE_P(
    Options, InvalidInput,
    testing::Values(
        Spoiled{"ZeroSigmaUv", [](Scene*, CostOptions* o) { o->uv_std_dev = 0; }, "of (u, v)"},
        Spoiled{"NegativeSigmaRho", [](Scene*, CostOptions* o) { o->rho_std_dev = -1; }, "of rho"},
        Spoiled{"NanSigmaCenters", [](Scene*, CostOptions* o) { o->centers_std_dev = kNan; },
                "of the centres"},
        Spoiled{"ZeroFeaturesLoss", [](Scene*, CostOptions* o) { o->features_loss.scale = 0; },
                "scale of the robust loss"},
        Spoiled{"InfiniteCentersLoss",
                [](Scene*, CostOptions* o) { o->centers_loss.scale = kInfinity; },
                "scale of the robust loss"},
        Spoiled{"UnknownFixed",
                [](Scene*, CostOptions* o) {
                  o->fix({"F", "focus"});
                },
                "no parameter focus"},
        Spoiled{"FixedTypeBeyond", [](Scene*, CostOptions* o) { o->fix({"f_4"}); },
                "no parameter f_4"}),
    test_name);

INSTANTIATE_TEST_SUITE_P(
    Camera, InvalidCamera,
    testing::Values(
        Spoiled{"NegativeColumns", [](Scene* s, CostOptions*) { s->camera.lattice.columns = -20; },
                "columns and rows"},
        Spoiled{"NoRows", [](Scene* s, CostOptions*) { s->camera.lattice.rows = 0; },
                "columns and rows"},
        Spoiled{"TwoTypes",
                [](Scene* s, CostOptions*) {
                  s->camera.micro_lens_focal_lengths = {0.5, 0.6};
                },
                "2 lens types"},
        Spoiled{"FourTypes",
                [](Scene* s, CostOptions*) {
                  s->camera.micro_lens_focal_lengths = {0.5, 0.6, 0.7, 0.8};
                },
                "4 lens types"},
        Spoiled{"ThreeTypesOnASquareLattice",
                [](Scene* s, CostOptions*) { s->camera.lattice.packing = Packing::kOrthogonal; },
                "3 lens types"},
        Spoiled{"PixelSize", [](Scene* s, CostOptions*) { s->camera.pixel_size = -0.0055; },
                "pixel size (mm) is -0.0055"},
        Spoiled{"F", [](Scene* s, CostOptions*) { s->camera.main_lens.focal_length = 0; },
                "F (mm) is 0"},
        Spoiled{"D", [](Scene* s, CostOptions*) { s->camera.mla.lens_to_mla = -56; },
                "D (mm) is -56"},
        Spoiled{"PupilBehindTheArray",
                [](Scene* s, CostOptions*) { s->camera.exit_pupil.z = -56.7; }, "e_z"},
        Spoiled{"PupilBehindTheFocalPoint",
                [](Scene* s, CostOptions*) { s->camera.exit_pupil.z = -50.5; }, "rear focal point"},
        Spoiled{"LittleD", [](Scene* s, CostOptions*) { s->camera.mla.mla_to_sensor = kNan; },
                "d (mm) is nan"},
        Spoiled{"Pitch", [](Scene* s, CostOptions*) { s->camera.mla.pitch = kInfinity; },
                "dC (mm) is inf"},
        Spoiled{"PitchRatio", [](Scene* s, CostOptions*) { s->camera.mla.pitch_ratio = 0; },
                "dC_ratio is 0"},
        Spoiled{"FocalLength",
                [](Scene* s, CostOptions*) { s->camera.micro_lens_focal_lengths[1] = -0.5; },
                "f_2 (mm) is -0.5"},
        Spoiled{"Distortion", [](Scene* s, CostOptions*) { s->camera.main_lens.radial[1] = kNan; },
                "Q2 is not"},
        Spoiled{"Tangential",
                [](Scene* s, CostOptions*) { s->camera.main_lens.tangential[0] = kInfinity; },
                "P1 is not"},
        Spoiled{"PrincipalPoint",
                [](Scene* s, CostOptions*) { s->camera.mla.principal_point[1] = kNan; },
                "v0 is not"},
        Spoiled{"Tilt", [](Scene* s, CostOptions*) { s->camera.mla.rotation.z = kNan; },
                "theta_z is not"},
        Spoiled{"Offset", [](Scene* s, CostOptions*) { s->camera.mla.offset[0] = kNan; },
                "t_x is not"}),
    test_name);

TEST(InvalidInput, FixedFocalLengthOfAPinholeArray) {
  const Scene scene = small_scene(0);
  CostOptions options;
  options.fix({"f_1"});
  expect_names(
      rejection([&] { refine(scene.camera, scene.poses, scene.observations, options, {}); }),
      "no parameter f_1");
}

TEST(InvalidInput, BlurOfAPinholeArrayIsNotChecked) {
  Scene scene = small_scene(0);
  for (FeatureObservation& o : scene.observations.features) {
    o.observed.rho = kNan;
    o.std_dev.rho = kNan;
  }
  EXPECT_EQ("(accepted)",
            rejection([&] { refine(scene.camera, scene.poses, scene.observations, {}, {}); }));
}

TEST(InvalidInput, SolverOptionsAreNamed) {
  const Scene scene = small_scene(1);
  const auto refused = [&](const SolverOptions& options) {
    return rejection([&] { refine(scene.camera, scene.poses, scene.observations, {}, options); });
  };
  SolverOptions threads;
  threads.threads = 0;
  expect_names(refused(threads), "threads");
  SolverOptions iterations;
  iterations.max_iterations = -1;
  expect_names(refused(iterations), "max_num_iterations");
  SolverOptions tolerance;
  tolerance.function_tolerance = kNan;
  expect_names(refused(tolerance), "function_tolerance");
  SolverOptions radius;
  radius.initial_trust_region_radius = -1.0;
  expect_names(refused(radius), "initial_trust_region_radius");
}

// Valid numbers at which the model is not defined: the solver cannot start, there is no Jacobian.
TEST(InvalidInput, BoardWithinTheFocalLength) {
  Scene scene = small_scene(3);
  scene.poses[1].translation.z = 40.0;
  expect_names(rejection([&] { refine(scene.camera, scene.poses, scene.observations, {}, {}); }),
               "focal length of the main lens");
  expect_names(rejection([&] { uncertainty(scene.camera, scene.poses, scene.observations, {}); }),
               "focal length of the main lens");
}

}  // namespace
}  // namespace plenocal
