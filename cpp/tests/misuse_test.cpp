// Ways to misuse a calibrated camera, with what has to come of each: the right value, nothing, or a
// refusal that names the value. No crash, and no number that is not one.
#include <gtest/gtest.h>

#include <algorithm>
#include <climits>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <functional>
#include <limits>
#include <random>
#include <regex>
#include <string>
#include <vector>

#include "plenocal/back_projection.hpp"
#include "plenocal/io.hpp"
#include "plenocal/points.hpp"
#include "plenocal/problem.hpp"
#include "plenocal/residuals.hpp"
#include "simple_camera.hpp"
#include "synthetic_scene.hpp"

namespace plenocal {
namespace {

using test::scene_camera;
using test::simple_camera;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

// A way to use or misuse something, and a part of what is said of it: "none" without a result,
// "finite" with one, the value, or "refused: " and the message.
struct Use {
  const char* name;
  std::function<std::string()> act;
  const char* outcome;
};

std::ostream& operator<<(std::ostream& out, const Use& use) { return out << use.name; }

std::string test_name(const testing::TestParamInfo<Use>& info) { return info.param.name; }

std::string said(std::initializer_list<double> values) {
  return std::all_of(values.begin(), values.end(), [](double x) { return std::isfinite(x); })
             ? "finite"
             : "not finite";
}
std::string said(const std::optional<double>& value) { return value ? said({*value}) : "none"; }
std::string said(const Vector3<double>& v) { return said({v.x, v.y, v.z}); }
std::string said(const Pixel<double>& p) { return said({p.u, p.v}); }
std::string said(const std::optional<Feature<double>>& f) {
  return f ? said({f->u, f->v, f->rho}) : "none";
}
std::string said(const std::optional<Ray<double>>& ray) {
  if (!ray) return "none";
  return said(ray->origin) == "finite" ? said(ray->direction) : "not finite";
}
std::string said(const std::optional<MetricPoint>& found) {
  if (!found) return "none";
  double sum = found->chi_square;
  for (double entry : found->covariance) sum += entry;
  return said({found->point.x, found->point.y, found->point.z, sum});
}
std::string said(const std::optional<MicroImage>& image) {
  return image ? said({image->center.u, image->center.v, image->distance}) : "none";
}
std::string rounded(double value) {
  char text[32];
  std::snprintf(text, sizeof(text), "%.6g", value);
  return text;
}

class Misuse : public testing::TestWithParam<Use> {};

TEST_P(Misuse, EndsAsExpected) {
  std::string outcome;
  try {
    outcome = GetParam().act();
  } catch (const std::invalid_argument& error) {
    outcome = std::string("refused: ") + error.what();
  } catch (const std::out_of_range& error) {
    outcome = std::string("refused: ") + error.what();
  } catch (const FileError& error) {
    outcome = std::string("refused: ") + error.what();
  }
  EXPECT_NE(outcome.find(GetParam().outcome), std::string::npos)
      << outcome << "\nwithout: " << GetParam().outcome;
}

// Of the simple camera: (150, 105) in micro-image (4, 3) shows z = 300 mm at nu = 2.
const BackProjection& back() {
  static const BackProjection back(simple_camera());
  return back;
}
const MicroPixel kSeen{4, 3, {150.0, 105.0}};
const Pose kFront{{}, {0.0, 0.0, 300.0}};

template <typename Change>
Camera changed(Camera camera, const Change& change) {
  change(&camera);
  return camera;
}

INSTANTIATE_TEST_SUITE_P(
    Projection, Misuse,
    testing::Values(
        Use{"ClearPoint",
            [] {
              return said(project(simple_camera(), kFront, {3, 1.5, 0}, 2, 2));
            },
            "finite"},
        Use{"PointIsNan",
            [] {
              return said(project(simple_camera(), kFront, {kNan, 0, 0}, 2, 2));
            },
            "none"},
        Use{"PointIsInfinite",
            [] {
              return said(project(simple_camera(), kFront, {0, kInfinity, 0}, 2, 2));
            },
            "none"},
        Use{"DepthIsInfinite",
            [] {
              return said(project(simple_camera(), kFront, {0, 0, kInfinity}, 2, 2));
            },
            "none"},
        Use{"PoseIsNan",
            [] {
              return said(project(simple_camera(), {{kNan, 0, 0}, {0, 0, 300}}, {}, 2, 2));
            },
            "none"},
        Use{"BehindTheLens",
            [] {
              return said(project(simple_camera(), {{}, {0, 0, -300}}, {}, 2, 2));
            },
            "none"},
        Use{"AtTheFocalPlane",
            [] {
              return said(project(simple_camera(), {{}, {0, 0, 50}}, {}, 2, 2));
            },
            "none"},
        Use{"WithinTheFocalLength",
            [] {
              return said(project(simple_camera(), {{}, {0, 0, 30}}, {}, 2, 2));
            },
            "none"},
        Use{"ColumnNegative", [] { return said(project(simple_camera(), kFront, {}, -1, 2)); },
            "none"},
        Use{"ColumnBeyond", [] { return said(project(simple_camera(), kFront, {}, 5, 2)); },
            "none"},
        Use{"RowIsTheLargestNumber",
            [] { return said(project(simple_camera(), kFront, {}, 2, INT_MAX)); }, "none"},
        Use{"RowIsTheLeastNumber",
            [] { return said(project(simple_camera(), kFront, {}, 2, INT_MIN)); }, "none"},
        Use{"CameraIsEmpty", [] { return said(project(Camera{}, kFront, {}, 0, 0)); },
            "refused: the columns and rows"},
        Use{"CentreOfAnEmptyCamera", [] { return said(project_center(Camera{}, 0, 0)); },
            "refused: the columns and rows"},
        Use{"CentreWithoutPitch",
            [] {
              return said(project_center(
                  changed(simple_camera(), [](Camera* c) { c->mla.pitch = kNan; }), 0, 0));
            },
            "refused: the camera's dC (mm) is nan"},
        Use{"CentreFarOutside",
            [] { return said(project_center(simple_camera(), INT_MAX, INT_MIN)); }, "finite"},
        Use{"FourLensTypesOfTemplates",
            [] {
              const Camera camera = changed(
                  simple_camera(), [](Camera* c) { c->micro_lens_focal_lengths.assign(4, 0.5); });
              return said({optics_of(camera).inverse_focal_lengths[0]});
            },
            "refused: cameras with 4 lens types are not supported"},
        Use{"LensTypeOfANegativeIndex",
            [] {
              const Lattice lattice = scene_camera(3).lattice;
              for (int k = -7; k < 7; ++k) {
                for (int l = -7; l < 7; ++l) {
                  const int type = lattice.lens_type(k, l, 3);
                  if (type < 0 || type > 2) return std::string("out of range");
                  if (type == lattice.lens_type(k + 1, l, 3))
                    return std::string("as its neighbour");
                }
              }
              return std::string("three types");
            },
            "three types"},
        Use{"LensTypeOfTheLargestIndex",
            [] { return std::to_string(scene_camera(3).lattice.lens_type(INT_MAX, INT_MAX, 3)); },
            "2"},
        Use{"NearestOfNan",
            [] {
              const Lattice lattice = scene_camera(3).lattice;
              const auto [k, l] = lattice.nearest({kNan, kInfinity});
              return std::string(lattice.contains(k, l) ? "inside" : "outside");
            },
            "outside"},
        Use{"TransformedByNan",
            [] {
              return said(transformed({{0, kNan, 0}, {}}, {1, 2, 3}));
            },
            "refused: the pose is not finite"},
        Use{"TransformedNan",
            [] {
              return said(transformed(kFront, {1, kNan, 3}));
            },
            "refused: the point is not finite"},
        Use{"InverseOfInfinity",
            [] {
              return said(inverse({{}, {0, 0, kInfinity}}).translation);
            },
            "refused: the pose is not finite"},
        Use{"ComposedWithNan",
            [] {
              return said(composed(kFront, {{}, {kNan, 0, 0}}).translation);
            },
            "refused: the pose is not finite"},
        Use{"ManyTurns",
            [] {
              return rounded(transformed({{0, 0, 200 * std::acos(-1.0)}, {}}, {1, 0, 0}).x);
            },
            "1"}),
    test_name);

INSTANTIATE_TEST_SUITE_P(
    BackProjection, Misuse,
    testing::Values(
        Use{"ClearRay", [] { return said(back().object_ray(kSeen, 300)); }, "finite"},
        Use{"PixelIsNan",
            [] {
              return said(back().object_ray({4, 3, {kNan, 105}}, 300));
            },
            "none"},
        Use{"PixelIsInfinite",
            [] {
              return said(back().ray_behind({4, 3, {150, -kInfinity}}));
            },
            "none"},
        Use{"PixelIsHuge",
            [] {
              return said(back().object_ray({4, 3, {1e300, 1e300}}, 300));
            },
            "none"},
        Use{"MicroLensOutside",
            [] {
              return said(back().object_ray({5, 3, {150, 105}}, 300));
            },
            "none"},
        Use{"PixelOffTheSensor",
            [] {
              const Camera camera = changed(simple_camera(), [](Camera* c) {
                c->width = 200;
                c->height = 160;
              });
              return said(BackProjection(camera).micro_image_at({200.0, 80.0}));
            },
            "none"},
        Use{"PixelBeforeTheSensor",
            [] {
              const Camera camera = changed(simple_camera(), [](Camera* c) {
                c->width = 200;
                c->height = 160;
              });
              return said(BackProjection(camera).micro_image_at({100.0, -0.6}));
            },
            "none"},
        Use{"MicroImageOfNan",
            [] {
              return said(back().micro_image_at({kNan, kNan}));
            },
            "none"},
        Use{"RayAtZero", [] { return said(back().object_ray(kSeen, 0)); }, "none"},
        Use{"RayBehindTheLens", [] { return said(back().object_ray(kSeen, -300)); }, "none"},
        Use{"RayAtNan", [] { return said(back().object_ray(kSeen, kNan)); }, "none"},
        Use{"ApertureIsNan",
            [] {
              return said(back().ray_behind(kSeen, {kNan, 0}));
            },
            "none"},
        Use{"DepthIsZero",
            [] {
              return said(back().point({kSeen, 0, {}}));
            },
            "none"},
        Use{"DepthIsNan",
            [] {
              return said(back().point({kSeen, kNan, {}}));
            },
            "none"},
        Use{"DepthIsInfinite",
            [] {
              return said(back().point({kSeen, kInfinity, {}}));
            },
            "none"},
        Use{"FocusedDepthIsZero",
            [] {
              return said(back().focused_point({kSeen, 0, {}}));
            },
            "none"},
        Use{"FocusedPixelIsNan",
            [] {
              return said(back().focused_point({{0, 0, {kNan, 0}}, 2, {}}));
            },
            "none"},
        // An image before the array, as a Galilean camera has it, and one before the sensor.
        Use{"DepthIsNegative",
            [] {
              return rounded(*back().virtual_depth(4, 3, back().point({kSeen, -3, {}})->point));
            },
            "-3"},
        Use{"DepthIsBelowOne",
            [] {
              return rounded(*back().virtual_depth(4, 3, back().point({kSeen, 0.5, {}})->point));
            },
            "0.5"},
        Use{"SigmaIsNegative",
            [] {
              return said(back().point({kSeen, 2, {0, -0.1, 0}}));
            },
            "refused: the standard deviations of u, v and the virtual depth"},
        Use{"SigmaIsNan",
            [] {
              return said(back().point({kSeen, 2, {0, 0, kNan}}));
            },
            "refused: the standard deviations of u, v and the virtual depth"},
        Use{"SigmaIsHuge",
            [] {
              return said(back().point({kSeen, 2, {1e200, 0, 0}}));
            },
            "none"},
        Use{"NothingToTriangulate", [] { return said(back().triangulate({})); }, "none"},
        Use{"OneSighting",
            [] {
              return said(back().triangulate({{4, 3, {150, 105, 0}}}));
            },
            "none"},
        Use{"TheSameSightingTwice",
            [] {
              return said(back().triangulate({{4, 3, {150, 105, 0}}, {4, 3, {150, 105, 0}}}));
            },
            "none"},
        Use{"SightingOutside",
            [] {
              return said(back().triangulate({{4, 3, {150, 105, 0}}, {7, 3, {130, 105, 0}}}));
            },
            "none"},
        Use{"SightingIsNan",
            [] {
              return said(back().triangulate({{4, 3, {150, 105, 0}}, {2, 3, {kNan, 105, 0}}}));
            },
            "none"},
        Use{"RhoThatCountsIsNan",
            [] {
              return said(back().triangulate(
                  {{4, 3, {150, 105, kNan}, {1, 1, 1}}, {2, 3, {130, 105, kNan}, {1, 1, 1}}}));
            },
            "none"},
        Use{"SigmaOfASightingIsZero",
            [] {
              return said(
                  back().triangulate({{4, 3, {150, 105, 0}, {0, 1, 1}}, {2, 3, {130, 105, 0}}}));
            },
            "refused: the standard deviation of u"},
        Use{"CorrelationIsOne",
            [] {
              return said(back().triangulate(
                  {{4, 3, {150, 105, 0}, {1, 1, 1}, 1.0}, {2, 3, {130, 105, 0}}}));
            },
            "refused: the correlation of u and v"},
        Use{"LossOfNoScale",
            [] {
              return said(back().triangulate({{4, 3, {150, 105, 0}}, {2, 3, {130, 105, 0}}},
                                             {LossKind::kHuber, 0.0}));
            },
            "refused: the scale of the loss"},
        Use{"BlurIsNan", [] { return said(back().virtual_depth_of_blur(4, 3, kNan)); }, "none"},
        Use{"BlurOfPinholes",
            [] {
              const Camera pinholes =
                  changed(simple_camera(), [](Camera* c) { c->micro_lens_focal_lengths.clear(); });
              return said(BackProjection(pinholes).virtual_depth_of_blur(4, 3, 0));
            },
            "none"},
        Use{"VirtualDepthBehindTheLens",
            [] {
              return said(back().virtual_depth(4, 3, {0, 0, -300}));
            },
            "none"},
        Use{"NullPixels",
            [] { return said({double(back().object_rays(nullptr, 1, 300, nullptr))}); },
            "refused: there are no pixels"},
        Use{"NoPixels", [] { return rounded(back().object_rays(nullptr, 0, 300, nullptr)); }, "0"},
        Use{"NullPoints", [] { return said({double(back().points(nullptr, 1, nullptr))}); },
            "refused: there are no points"},
        Use{"HugeSensor",
            [] {
              BackProjection(
                  changed(simple_camera(), [](Camera* c) { c->width = c->height = 60000; }));
              return std::string("accepted");
            },
            "refused: a sensor of 60000 x 60000 px is too large: at most 268435456 px"},
        Use{"SensorOfTheLargestNumbers",
            [] {
              BackProjection(
                  changed(simple_camera(), [](Camera* c) { c->width = c->height = INT_MAX; }));
              return std::string("accepted");
            },
            "refused: a sensor of 2147483647 x 2147483647 px"},
        Use{"NegativeSensor",
            [] {
              BackProjection(changed(simple_camera(), [](Camera* c) { c->width = -1; }));
              return std::string("accepted");
            },
            "refused: the camera's width or height is negative"}),
    test_name);

INSTANTIATE_TEST_SUITE_P(
    Points, Misuse,
    testing::Values(
        Use{"NobodySeesNan",
            [] {
              return rounded(micro_lenses_seeing(simple_camera(), {kNan, 0, 300}, 0).size());
            },
            "0"},
        Use{"NobodySeesBehind",
            [] {
              return rounded(micro_lenses_seeing(simple_camera(), {0, 0, -300}, 0).size());
            },
            "0"},
        Use{"NobodySeesInfinity",
            [] {
              return rounded(micro_lenses_seeing(simple_camera(), {0, 0, kInfinity}, 0).size());
            },
            "0"},
        Use{"MarginIsNegative",
            [] {
              return rounded(micro_lenses_seeing(simple_camera(), {0, 0, 300}, -1).size());
            },
            "refused: the margin"},
        Use{"MarginIsWide",
            [] {
              return rounded(micro_lenses_seeing(simple_camera(), {0, 0, 300}, 1e9).size());
            },
            "0"},
        Use{"NoiseIsNegative",
            [] {
              point_sensitivity(simple_camera(), {0, 0, 300}, {-0.1, 0.1, 0.1}, 0);
              return std::string("accepted");
            },
            "refused: the standard deviation of u"},
        Use{"UnseenPointHasNoSensitivity",
            [] {
              const auto response =
                  point_sensitivity(simple_camera(), {1e6, 0, 300}, {0.1, 0.1, 0.1}, 0);
              return std::to_string(response.micro_lenses) +
                     (std::isnan(response.covariance[0]) ? " nan, as documented" : " finite");
            },
            "0 nan, as documented"},
        Use{"EntryOutsideOfAMatrix",
            [] {
              return said({Matrix{2, 2, {1, 2, 3, 4}}(0, 2)});
            },
            "refused: there is no entry (0, 2) in a matrix of 2 x 2"},
        Use{"CornerOfNoBoard", [] { return said(BoardGrid{}.corner(3)); },
            "refused: corner 3 is not on a board of 0 x 0"},
        Use{"CornerBeyondTheBoard",
            [] {
              return said(BoardGrid{9, 5, 3.0}.corner(45));
            },
            "refused: corner 45 is not on a board of 9 x 5"},
        Use{"BentBoardWithoutSize",
            [] {
              return said(corner_of(Board{0, 0, {0.1, 0, 0, 0}}, {1, 2, 0}));
            },
            "refused: a board that is not flat needs a size"}),
    test_name);

// A scene of two frames, and what is wrong with the camera or the observations.
struct Small {
  test::Scene scene = test::make_scene(3);
  CostOptions options = test::paper();

  Small() {
    scene.poses.resize(2);
    scene.observations = test::observe(scene.camera, scene.poses);
  }
  std::string cost() const {
    const CalibrationProblem problem(scene.camera, scene.poses, scene.observations, options);
    return problem.evaluate().cost < 1e-9 ? "no residuals" : "residuals";
  }
};

template <typename Change>
std::string cost_with(const Change& change) {
  Small small;
  change(&small);
  return small.cost();
}

std::string residuals_with(double pixel_size, const std::vector<WeightedFeature>& features) {
  FeatureResiduals<3>::create(features, pixel_size, {});
  return "accepted";
}

WeightedFeature weighted() { return {{1, 2, 0}, {{0.5, 0.5}, 1}, {100, 80, 0.5}, {10, 10, 10}}; }

INSTANTIATE_TEST_SUITE_P(
    Problems, Misuse,
    testing::Values(
        Use{"TheCameraItself", [] { return cost_with([](Small*) {}); }, "no residuals"},
        // Valid by itself, but of another camera: the cost tells.
        Use{"OtherParity",
            [] {
              return cost_with(
                  [](Small* s) { s->scene.camera.lattice.packing = Packing::kHexagonalRowsOdd; });
            },
            "residuals"},
        Use{"OtherDirection",
            [] {
              return cost_with([](Small* s) {
                s->scene.camera.lattice.packing = Packing::kHexagonalColumnsEven;
              });
            },
            "residuals"},
        Use{"SmallerArray",
            [] { return cost_with([](Small* s) { s->scene.camera.lattice.columns = 10; }); },
            "is outside the array of 10 x 18"},
        Use{"SquareLattice",
            [] {
              return cost_with(
                  [](Small* s) { s->scene.camera.lattice.packing = Packing::kOrthogonal; });
            },
            "refused: a camera of 3 lens types"},
        Use{"OneLensType",
            [] {
              return cost_with(
                  [](Small* s) { s->scene.camera.micro_lens_focal_lengths.resize(1); });
            },
            "residuals"},
        Use{"PriorOfAnotherLensType",
            [] {
              return cost_with([](Small* s) {
                s->scene.camera.micro_lens_focal_lengths.resize(1);
                s->options.priors.push_back({"f_2", 0.5, 0.1});
              });
            },
            "refused: there is no parameter f_2"},
        Use{"NoObservations",
            [] { return cost_with([](Small* s) { s->scene.observations = {}; }); },
            "refused: pose 0 has no feature"},
        Use{"FewerPosesThanFrames",
            [] { return cost_with([](Small* s) { s->scene.poses.resize(1); }); },
            "refused: a feature belongs to frame 1, which has no pose"},
        Use{"FixedPoseBeyond",
            [] { return cost_with([](Small* s) { s->options.fixed_poses = {2}; }); },
            "refused: there is no pose 2 to fix"},
        Use{"PriorSigmaIsNegative",
            [] { return cost_with([](Small* s) {
                   s->options.priors.push_back({"F", 50, -1});
                 }); },
            "refused: the standard deviation of the prior of F"},
        Use{"PriorIsNan",
            [] { return cost_with([](Small* s) {
                   s->options.priors.push_back({"F", kNan, 1});
                 }); },
            "refused: the prior of F is not finite"},
        Use{"PriorWeightIsZero",
            [] { return cost_with([](Small* s) { s->options.prior_weight = 0; }); },
            "refused: the weight of the priors"},
        Use{"SigmaIsTiny",
            [] { return cost_with([](Small* s) { s->options.uv_std_dev = 1e-310; }); },
            "refused: the weight of a feature"},
        Use{"FreeWhatIsFree", [] { return cost_with([](Small* s) { s->options.free({"F"}); }); },
            "refused: the parameter F is not fixed"},
        Use{"StateOfAnotherCamera",
            [] {
              const Small small;
              CalibrationProblem problem(small.scene.camera, small.scene.poses,
                                         small.scene.observations, small.options);
              problem.set_state(std::vector<double>(7, 1.0));
              return std::string("accepted");
            },
            "refused: the state belongs to another problem"},
        Use{"StateIsNan",
            [] {
              const Small small;
              CalibrationProblem problem(small.scene.camera, small.scene.poses,
                                         small.scene.observations, small.options);
              auto state = problem.state();
              state[0] = kNan;
              problem.set_state(state);
              return std::string("accepted");
            },
            "refused: the state is not finite"},
        Use{"SystematicErrorOfOthers",
            [] {
              const Small small;
              SystematicError error;
              error.features.resize(3);
              uncertainty(small.scene.camera, small.scene.poses, small.scene.observations,
                          small.options, {error});
              return std::string("accepted");
            },
            "refused: a systematic error does not belong to these observations"},
        Use{"NoThreads",
            [] {
              const Small small;
              uncertainty(small.scene.camera, small.scene.poses, small.scene.observations,
                          small.options, {}, 0);
              return std::string("accepted");
            },
            "refused: threads has to be at least 1"},
        Use{"CovarianceOfNoParameter", [] { return said({Uncertainty{}.covariance_of("F", "F")}); },
            "refused: there is no free parameter F"},
        Use{"ResidualsOfNothing", [] { return residuals_with(0.0055, {}); },
            "refused: a residual block needs an observation"},
        Use{"ResidualsWithoutPixels", [] { return residuals_with(0.0, {weighted()}); },
            "refused: the pixel size (mm)"},
        Use{"WeightIsNegative",
            [] {
              auto feature = weighted();
              feature.weight.v = -1;
              return residuals_with(0.0055, {feature});
            },
            "refused: the weight of a feature"},
        Use{"LensTypeBeyond",
            [] {
              auto feature = weighted();
              feature.micro_lens.lens_type = 3;
              return residuals_with(0.0055, {feature});
            },
            "refused: a feature has a lens type"},
        Use{"LossWithoutScale",
            [] {
              FeatureResiduals<3>::create({weighted()}, 0.0055, {LossKind::kCauchy, kNan});
              return std::string("accepted");
            },
            "refused: the scale of the robust loss"},
        Use{"ShapeWithoutSize",
            [] {
              FeatureResiduals<3, true>::create({weighted()}, 0.0055, {});
              return std::string("accepted");
            },
            "refused: a board whose shape is a parameter needs a size"},
        Use{"CentresWithoutWeight",
            [] {
              CenterResiduals::create({{{0, 0}, {100, 80}, 0.0}}, 0.0055, {});
              return std::string("accepted");
            },
            "refused: the weight of a centre"},
        Use{"InterceptOfNoType",
            [] {
              InterceptResidual<3>::create(3, 0.04, 1);
              return std::string("accepted");
            },
            "refused: there is no lens type 3"},
        Use{"TiltAlongNoAxis",
            [] {
              TiltGradientResidual::create(2, 0.0, 1);
              return std::string("accepted");
            },
            "refused: there is no axis 2"}),
    test_name);

std::string path() {
  return testing::TempDir() + "plenocal_misuse_" + std::to_string(std::random_device()());
}

CameraFile camera_file() {
  CameraFile file;
  file.camera = scene_camera(3);
  file.camera.width = 464;
  file.camera.height = 365;
  file.f_number = 4.0;
  file.converged = true;
  file.verdict = Verdict::kGood;
  file.std_dev.assign(intrinsic_names(3).size(), 0.5);
  const int n = static_cast<int>(file.std_dev.size());
  file.covariance = {n, n, std::vector<double>(static_cast<std::size_t>(n) * n, 0.0)};
  for (int i = 0; i < n; ++i) file.covariance.values[static_cast<std::size_t>(i) * (n + 1)] = 0.25;
  return file;
}

// What comes of a file whose text was changed; messages have to name the file.
std::string read_with(const std::function<std::string(std::string)>& change) {
  const std::string file = path();
  write_camera(file, camera_file());
  std::ifstream in(file);
  const std::string text{std::istreambuf_iterator<char>(in), {}};
  std::ofstream(file) << change(text);
  std::string outcome;
  try {
    const CameraFile read = read_camera(file);
    outcome = "read, " + std::to_string(read.objections().size()) + " objections";
    for (const std::string& objection : read.objections()) outcome += ": " + objection;
  } catch (const FileError& error) {
    outcome = error.what();
    EXPECT_EQ(outcome.rfind(file, 0), 0U) << outcome;
    outcome.replace(0, file.size(), "refused");
  }
  std::remove(file.c_str());
  return outcome;
}

std::string read_with(const char* pattern, const char* by) {
  return read_with([&](const std::string& text) {
    const std::string changed =
        std::regex_replace(text, std::regex(pattern), by, std::regex_constants::format_first_only);
    EXPECT_NE(changed, text) << pattern;
    return changed;
  });
}

std::string written_with(const std::function<void(CameraFile*)>& change) {
  CameraFile file = camera_file();
  change(&file);
  const std::string name = path();
  write_camera(name, file);
  std::remove(name.c_str());
  return "written";
}

INSTANTIATE_TEST_SUITE_P(
    Files, Misuse,
    testing::Values(
        Use{"ClearFile", [] { return read_with("F", "F "); }, "read, 0 objections"},
        Use{"EmptyFile", [] { return read_with([](auto) { return ""; }); }, "refused: is not JSON"},
        Use{"CutFile", [] { return read_with([](auto text) { return text.substr(0, 300); }); },
            "refused: is not JSON"},
        Use{"ManyBrackets", [] { return read_with([](auto) { return std::string(200000, '['); }); },
            "refused: is not JSON"},
        Use{"BytesThatAreNoText",
            [] { return read_with([](auto text) { return "\xff\xfe" + text; }); },
            "refused: is not JSON"},
        Use{"AList", [] { return read_with([](auto) { return "[1, 2]"; }); },
            "refused: is not a plenocal-camera file"},
        Use{"Null", [] { return read_with([](auto) { return "null"; }); },
            "refused: is not a plenocal-camera file"},
        Use{"VersionIsAText", [] { return read_with("\"version\": 2", "\"version\": \"2\""); },
            "refused: version is not a whole number"},
        Use{"VersionOfTheFuture", [] { return read_with("\"version\": 2", "\"version\": 99"); },
            "refused: has version 99"},
        Use{"MisspeltField", [] { return read_with("\"focal_length_mm\"", "\"focal_lenght_mm\""); },
            "refused: has the unknown field main_lens.focal_lenght_mm"},
        Use{"UnknownFieldOfTheFile",
            [] { return read_with("\"format\"", "\"calibrated_by\": \"me\", \"format\""); },
            "refused: has the unknown field calibrated_by"},
        Use{"UnknownFieldOfTheSensor",
            [] { return read_with("\"width_px\"", "\"width\": 464, \"width_px\""); },
            "refused: has the unknown field sensor.width"},
        Use{"UnknownFieldOfTheArray",
            [] { return read_with("\"columns\"", "\"tilt\": 0, \"columns\""); },
            "refused: has the unknown field micro_lens_array.tilt"},
        Use{"MissingField", [] { return read_with("\"pitch_ratio\": 1.0,", ""); },
            "refused: there is no micro_lens_array.pitch_ratio"},
        Use{"NumberTooLarge",
            [] { return read_with("\"pitch_ratio\": 1.0", "\"pitch_ratio\": 1e999"); }, "refused"},
        Use{"NumberIsAText",
            [] { return read_with("\"pitch_ratio\": 1.0", "\"pitch_ratio\": \"1\""); },
            "refused: micro_lens_array.pitch_ratio is not a number"},
        Use{"AnglesInDegrees",
            [] { return read_with("(\"rotation_rad\": \\[\\s*)0.004", "$0190.0"); },
            "refused: micro_lens_array.rotation_rad is not angles in rad"},
        Use{"AngleOfManyTurns",
            [] { return read_with("(\"rotation_rad\": \\[\\s*)0.004", "$011e9"); },
            "refused: micro_lens_array.rotation_rad is not angles in rad"},
        Use{"TwoAngles", [] { return read_with("(\"rotation_rad\": \\[\\s*)0.004,", "$01"); },
            "refused: micro_lens_array.rotation_rad"},
        Use{"LensInDegrees",
            [] { return read_with("(\"rotation_rad\": \\[\\s*)0.006", "$0190.0"); },
            "the main lens is rotated by 90"},
        Use{"ThreeAnglesOfLens",
            [] { return read_with("(\"rotation_rad\": \\[\\s*)0.006", "$010.0, 0.006"); },
            "refused: main_lens.rotation_rad is not two angles in rad"},
        Use{"NearIsFar",
            [] {
              return read_with("\"format\"",
                               "\"boards\": {\"near_mm\": 5, \"far_mm\": -3}, \"format\"");
            },
            "refused: boards.near_mm is not at most boards.far_mm"},
        Use{"HugeSensor", [] { return read_with("\"width_px\": 464", "\"width_px\": 2000000"); },
            "refused: a sensor of 2000000 x 365 px is too large: at most 268435456 px"},
        Use{"FourLensTypes",
            [] { return read_with("\"focal_lengths_mm\": \\[", "\"focal_lengths_mm\": [0.5,"); },
            "refused: micro_lens_array.focal_lengths_mm is not a list of at most 3"},
        Use{"NoParity", [] { return read_with("\"shifted\": \"even\"", "\"shifted\": null"); },
            "refused: micro_lens_array.shifted is not a text"},
        Use{"ApertureIsNegative", [] { return read_with("\"f_number\": 4.0", "\"f_number\": -4"); },
            "refused: main_lens.f_number is not a positive number"},
        Use{"NotConverged", [] { return read_with("\"converged\": true", "\"converged\": false"); },
            "1 objections: the calibration of this camera has not converged"},
        Use{"ConvergedIsANumber",
            [] { return read_with("\"converged\": true", "\"converged\": 1"); },
            "refused: converged is not true or false"},
        Use{"DoNotUse", [] { return read_with("\"good\"", "\"do not use\""); },
            "1 objections: the verdict on the calibration of this camera is \"do not use\""},
        Use{"UnknownVerdict", [] { return read_with("\"good\"", "\"excellent\""); },
            "refused: verdict.verdict is not good, usable with care or do not use"},
        Use{"NotDetermined", [] { return read_with("(\"D\": \\{[^}]*\"value\": )0.5", "$1null"); },
            "1 objections: the calibration of this camera has not determined D"},
        Use{"SigmaIsNegative",
            [] { return read_with("(\"D\": \\{[^}]*\"value\": )0.5", "$1-0.5"); },
            "refused: uncertainty.standard_deviations.D.value is not a standard deviation"},
        Use{"SigmasAreAList",
            [] {
              return read_with("\"standard_deviations\": \\{",
                               "\"standard_deviations\": [], \"other\": {");
            },
            "refused: uncertainty.standard_deviations is not a table"},
        Use{"CorrelationIsLarge",
            [] { return read_with("(\"matrix\": \\[\\s*\\[\\s*)1.0", "$017.0"); },
            "refused: uncertainty.correlations.matrix[0][0] is not a correlation"},
        Use{"CorrelationsAreMissing",
            [] { return read_with("\"matrix\": \\[", "\"matrix\": [], \"other\": ["); },
            "refused: there is no uncertainty.correlations.matrix[0]"},
        Use{"WriteTooFewSigma", [] { return written_with([](auto* f) { f->std_dev.resize(3); }); },
            "refused: the camera has 29 parameters, but 3 standard deviations"},
        Use{"WriteNegativeSigma", [] { return written_with([](auto* f) { f->std_dev[4] = -1; }); },
            "refused: a standard deviation of the camera is -1"},
        Use{"WriteSmallCovariance",
            [] { return written_with([](auto* f) {
                   f->covariance = {2, 2, {1, 0, 0, 1}};
                 }); },
            "refused: the covariance of the camera is 2 x 2, but 29 parameters"},
        Use{"WriteCutCovariance",
            [] { return written_with([](auto* f) { f->covariance.values.resize(5); }); },
            "refused: the covariance of the camera"},
        Use{"WriteWithoutAperture",
            [] { return written_with([](auto* f) { f->f_number = kNan; }); },
            "refused: the f-number of the camera"},
        Use{"WriteHugeSensor",
            [] { return written_with([](auto* f) { f->camera.width = INT_MAX; }); },
            "refused: a sensor of 2147483647 x 365 px"},
        Use{"WriteToNoFolder",
            [] {
              write_camera("/none/of/this/camera.json", camera_file());
              return std::string("written");
            },
            "refused: /none/of/this/camera.json: cannot be written"}),
    test_name);

// Clean uses beside, of the camera of the scene.
class CleanUse : public testing::TestWithParam<int> {};

TEST_P(CleanUse, ThereAndBackIsExact) {
  const Camera camera = scene_camera(GetParam());
  const BackProjection back(camera);
  for (double z : {230.0, 260.0, 300.0}) {
    const Vector3<double> point{0.004 * z, -0.003 * z, z};
    const auto lenses = micro_lenses_seeing(camera, point, 0.5);
    ASSERT_GE(lenses.size(), 2U);
    std::vector<Sighting> sightings;
    for (const auto& [k, l] : lenses) {
      const Feature<double> seen = project(camera, Pose{}, point, k, l).value();
      sightings.push_back({k, l, seen, {0.1, 0.1, kInfinity}});
      const MicroPixel pixel{k, l, {seen.u, seen.v}};
      // By its virtual depth, by a ray, and by the pixel alone.
      const double depth = back.virtual_depth(k, l, point).value();
      const auto found = back.point({pixel, depth, {0.1, 0.1, 0.01}});
      ASSERT_TRUE(found);
      EXPECT_NEAR(found->point.z, z, 1e-6);
      EXPECT_GT(found->covariance[8], 0.0);
      const auto ray = back.object_ray(pixel, z);
      ASSERT_TRUE(ray);
      EXPECT_NEAR(ray->origin.x, point.x, 1e-9);
      EXPECT_NEAR(ray->origin.y, point.y, 1e-9);
      const auto image = back.micro_image_at(pixel.pixel);
      ASSERT_TRUE(image);
      EXPECT_EQ(image->k, k);
      EXPECT_EQ(image->l, l);
      if (camera.lens_types() > 0) {
        EXPECT_NEAR(back.virtual_depth_of_blur(k, l, seen.rho).value(), depth, 1e-9 * depth);
      }
    }
    const auto found = back.triangulate(sightings);
    ASSERT_TRUE(found);
    EXPECT_NEAR(found->point.x, point.x, 1e-6);
    EXPECT_NEAR(found->point.z, z, 1e-5);
  }
}

INSTANTIATE_TEST_SUITE_P(LensTypes, CleanUse, testing::Values(0, 1, 3));

TEST(CleanUse, SensorsUpToTheLimitAreAccepted) {
  Camera camera = simple_camera();
  camera.width = camera.height = 1 << 14;
  EXPECT_NO_THROW(BackProjection{camera});
}

TEST(CleanUse, TheShippedCameraIsReadWithoutObjections) {
  const CameraFile file = read_camera(std::string(PLENOCAL_DATA) + "/truth/camera.json");
  EXPECT_TRUE(file.objections().empty());
  EXPECT_NO_THROW(BackProjection{file.camera});
}

TEST(CleanUse, AnglesOfATurnAreRead) {
  EXPECT_EQ(read_with("(\"rotation_rad\": \\[\\s*)0.004", "$01-6.283185307179586"),
            "read, 0 objections");
}

TEST(CleanUse, BoardsAtOneDistanceAreRead) {
  EXPECT_EQ(read_with("\"format\"",
                      "\"boards\": {\"frames\": 1, \"near_mm\": 5, \"far_mm\": 5}, \"format\""),
            "read, 0 objections");
}

TEST(CleanUse, ACameraWithoutApertureIsRead) {
  EXPECT_EQ(read_with("\"f_number\": 4.0,", ""), "read, 0 objections");
}

TEST(CleanUse, FieldsOfEarlierVersionsAreKnown) {
  EXPECT_EQ(read_with("\"columns\"", "\"fill_factor\": {\"value\": 1}, \"columns\""),
            "read, 0 objections");
}

TEST(CleanUse, AllThatIsKnownOfACameraComesBack) {
  const std::string file = path();
  const CameraFile written = camera_file();
  write_camera(file, written);
  const CameraFile read = read_camera(file);
  std::remove(file.c_str());
  EXPECT_EQ(read.covariance.values, written.covariance.values);
  EXPECT_EQ(read.std_dev, written.std_dev);
  EXPECT_EQ(read.verdict, written.verdict);
}

TEST(CleanUse, PosesAreComposedAndUndone) {
  const Pose pose{{0.1, -0.2, 0.3}, {1, 2, 300}};
  const Pose back = composed(inverse(pose), pose);
  for (double value : pose_block(back)) EXPECT_NEAR(value, 0.0, 1e-12);
}

TEST(CleanUse, CornersOfABoardAreOnIt) {
  const BoardGrid board{9, 5, 3.0};
  EXPECT_EQ(board.corner(0).x, 0.0);
  EXPECT_EQ(board.corner(44).x, 24.0);
  EXPECT_EQ(board.corner(44).y, 12.0);
}

TEST(CleanUse, TheTrueCameraIsRefinedToItself) {
  const Small small;
  const Refinement refined =
      refine(small.scene.camera, small.scene.poses, small.scene.observations, small.options, {});
  EXPECT_LT(refined.cost, 1e-12);
  EXPECT_NEAR(refined.camera.main_lens.focal_length, 50.0, 1e-6);
}

}  // namespace
}  // namespace plenocal
