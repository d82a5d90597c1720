# Installs the library into an empty prefix, then configures, builds and runs the consumer there.
# cmake -D library_build=… -D source=… -D scratch=… -D generator=… -D compiler=… -D flags=…
# -D config=… -D programs=… -P …

function(run)
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE result)
  if(NOT result EQUAL 0)
    list(JOIN ARGN " " command)
    message(FATAL_ERROR "failed (${result}): ${command}")
  endif()
endfunction()

# Files from an earlier run must not hide what this one fails to install.
file(REMOVE_RECURSE ${scratch})

run(${CMAKE_COMMAND} --install ${library_build} --prefix ${scratch}/prefix --config ${config})
run(${CMAKE_COMMAND} -S ${source} -B ${scratch}/build -G ${generator}
  -DCMAKE_PREFIX_PATH=${scratch}/prefix -DCMAKE_CXX_COMPILER=${compiler} -DCMAKE_CXX_FLAGS=${flags}
  -DCMAKE_BUILD_TYPE=${config} -DCMAKE_RUNTIME_OUTPUT_DIRECTORY=${scratch}/bin
  -DCMAKE_RUNTIME_OUTPUT_DIRECTORY_${config}=${scratch}/bin)
run(${CMAKE_COMMAND} --build ${scratch}/build --config ${config})
run(${scratch}/bin/consumer)
# The examples are programs too, if they are built.
foreach(program ${programs})
  run(${scratch}/prefix/bin/${program})
endforeach()
